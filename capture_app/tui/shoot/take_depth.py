"""The depth of each take, made at once at the lowest priority: one that went wrong is seen on the spot."""

import os
from collections.abc import Iterator
from pathlib import Path

import msgspec
from textual.content import Content

from capture_app.errors import SimulshotError
from capture_app.session.format.checks import inside
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.text import UNREADABLE, printable
from capture_app.tui.jobs.run import MOMENT, Run, RunState, progress_words
from capture_app.tui.jobs.runs import Runs
from capture_app.tui.widgets.picture import Source

SLOW_S = 60.0
"""Depth that keeps all processors of this machine busy for longer is not made by itself again."""


class TakeDepth:
    """Starts a run for each new take; a burst has the machine to itself, as with all runs."""

    def __init__(self, runs: Runs | None) -> None:
        """`runs`: None where nothing is to be made."""
        self._runs = runs
        self._picture: tuple[Path, bytes] | None = None

    async def begin(self, sheet: TakeSheet) -> None:
        """Make the depth of a take's middle instant, and not of one before it that still waits."""
        if self._runs is None or len(sheet.cameras) < 2:
            return
        for run in [run for run in self._runs.unfinished if run.kind == MOMENT.name]:
            if run.state is RunState.WAITING:
                await self._runs.cancel(run)
        if not self._is_slow:
            self._runs.add(MOMENT, sheet.session.folder, f"--instant {sheet.instants // 2}")

    @property
    def _is_slow(self) -> bool:
        # What it waited for others says nothing of the machine.
        most_s = SLOW_S * (os.cpu_count() or 1)
        runs = [] if self._runs is None else self._runs.all
        return any(run.processor_s > most_s for run in runs if run.kind == MOMENT.name)

    def of(self, sheet: TakeSheet | None) -> Run | None:
        """The run of a take."""
        found = [] if self._runs is None or sheet is None else self._runs.of(sheet.session.folder)
        return next((run for run in found if run.kind == MOMENT.name), None)

    def lines(self, sheet: TakeSheet | None) -> Iterator[Content]:
        """What came of it, or how far it is."""
        run = self.of(sheet)
        if run is None:
            if sheet is not None and self._is_slow:
                slow = f"no depth by itself: it takes over {SLOW_S:.0f} s here"
                yield Content.styled(slow, "$foreground-muted")
        elif not run.state.is_over:
            yield Content.styled(f"◔ depth {progress_words(run) or run.state}", "$primary")
        elif run.state is RunState.DONE:
            yield Content.styled(f"✔ {printable(run.message)}", "$success")
            yield Content.styled("d turns it in the browser", "$foreground-muted")
        else:
            yield Content.styled(f"no depth: {printable(run.message)}", "$foreground-muted")

    def picture(self, sheet: TakeSheet | None) -> Source | None:
        """The middle camera's depth."""
        run = self.of(sheet)
        if run is None or run.result is None:
            return None
        if self._picture is None or self._picture[0] != run.result:
            try:
                found = msgspec.json.decode(run.result.read_bytes())
                view = next(view for view in found["views"] if view["camera"] == found["reference"])
                self._picture = run.result, inside(run.result.parent, view["picture"]).read_bytes()
            except (*UNREADABLE, SimulshotError, OSError, LookupError, StopIteration, TypeError):
                return None
        return self._picture[1]
