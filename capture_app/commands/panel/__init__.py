"""`capture-app panel`: a clock that every camera sees, a file for each subcommand."""

from capture_app.commands.panel.command import panel as panel
