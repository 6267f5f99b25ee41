"""Process that nodes join: engine, network, sessions folder, and answers to operators."""
