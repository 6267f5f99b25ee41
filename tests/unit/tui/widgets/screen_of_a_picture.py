"""Screens that show one picture and end, one after the other, for a test that is their terminal."""

import os
import sys
from typing import Any

import numpy as np
from textual.app import App, ComposeResult
from textual.pilot import Pilot

from capture_app.tui.widgets.picture import Picture, SharpTerminal, find_sharp_terminal

END = b"<END>"


class PictureApp(App[None]):
    def __init__(self, sharp_terminal: SharpTerminal | None) -> None:
        super().__init__()
        self.sharp_terminal = sharp_terminal
        self.picture = Picture()

    def compose(self) -> ComposeResult:
        yield self.picture

    def on_mount(self) -> None:
        """Show a grey ramp."""
        ramp = np.tile(np.arange(0, 256, 4, dtype=np.uint8), (48, 1))
        self.picture.show(ramp, sharp=ramp)


async def leave_when_drawn(pilot: Pilot[Any]) -> None:
    await pilot.pause()
    await pilot.app.workers.wait_for_complete()
    await pilot.pause()
    pilot.app.exit()


def show(choice: str) -> None:
    """Run a screen in a process of its own: a terminal is asked once in a process."""
    if not (child := os.fork()):
        PictureApp(find_sharp_terminal(choice)).run(auto_pilot=leave_when_drawn)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    os.write(1, END)


if __name__ == "__main__":
    for choice in sys.argv[1:]:
        show(choice)
