"""The group of `capture-app panel`."""

import click

from capture_app.commands.panel.read import read
from capture_app.commands.panel.show import show
from capture_app.commands.panel.sketch import sketch
from capture_app.usage import examples


@click.group(epilog=examples("capture-app panel show", "capture-app panel read sessions/burst-001"))
def panel() -> None:
    """Show the time to all cameras at once, and read from their pictures how far apart they are.

    The whole way is in docs/panel.md.
    """


for command in (show, read, sketch):
    panel.add_command(command)
