"""The subcommands of `reconstruct`, one module each."""
