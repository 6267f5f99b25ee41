"""How soon a node joins, or says why it does not."""
