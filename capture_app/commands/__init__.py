"""The subcommands of `capture-app`, one module each; every one imports what it needs when it runs.

Those that look at a running rig or order it are in `operator`.
"""
