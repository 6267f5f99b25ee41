"""What a leader runs on its own machine, as processes that end with it: nodes, and the server of phones."""
