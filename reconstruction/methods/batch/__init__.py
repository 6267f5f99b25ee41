"""Many sessions and instants as independent work units, on this machine or a cluster."""
