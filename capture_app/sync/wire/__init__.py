"""Messages between nodes over datagrams, and their encoding."""
