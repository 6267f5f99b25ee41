"""`capture-app sessions`: what is done with sessions on disk, a file for each larger subcommand."""
