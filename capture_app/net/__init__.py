"""Network transport: datagrams for time and triggers, streams for images, discovery of leaders."""
