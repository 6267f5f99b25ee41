"""Messages between operators, leaders and nodes over streams: status, orders, pairing, transfer, events."""
