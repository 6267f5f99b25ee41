"""Terminal input and output of commands: help, options, progress, errors, JSON."""
