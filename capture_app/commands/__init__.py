"""The subcommands of `capture-app`, one module each; each imports what it needs when it runs."""
