"""The pump between the engine and the network: datagrams for time and triggers, streams for images."""
