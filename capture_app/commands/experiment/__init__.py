"""`capture-app experiment`: one command an experiment, those with options of their own in a file each."""
