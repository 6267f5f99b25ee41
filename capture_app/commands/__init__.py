"""The subcommands of `capture-app`, one module each; every one imports what it needs when it runs."""
