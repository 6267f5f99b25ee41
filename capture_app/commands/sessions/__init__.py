"""`capture-app sessions`: what is done with sessions on disk, a file for each larger subcommand."""

from capture_app.commands.sessions.command import sessions as sessions
