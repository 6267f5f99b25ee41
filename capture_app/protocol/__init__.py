"""Messages between operators, leaders and nodes over streams, and the role that each requires."""
