"""Leader and client as running things: an engine, a camera, a network, a status."""
