"""`capture-app experiment`: a command for each, and the options that they share."""

from capture_app.commands.experiment.command import experiment as experiment
