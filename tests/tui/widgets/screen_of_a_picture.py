"""A screen that shows one picture and ends, for a test that is its terminal."""

import sys
from typing import Any

import numpy as np
from textual.app import App, ComposeResult
from textual.pilot import Pilot

from capture_app.tui.widgets.picture import Picture, SharpTerminal, find_sharp_terminal


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


if __name__ == "__main__":
    PictureApp(find_sharp_terminal(sys.argv[1])).run(auto_pilot=leave_when_drawn)
