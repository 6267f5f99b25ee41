"""Depth of each take, computed at once at the lowest priority, to notice a failed take on the spot."""

import os
from collections.abc import Iterator
from functools import lru_cache

from textual.content import Content

from capture_app.common.errors import SimulshotError
from capture_app.common.text import UNREADABLE, printable
from capture_app.session.reading.take_sheet import PAIR_DEPTH, TakeSheet, depth_picture
from capture_app.tui.jobs.run import MOMENT, Run, RunState, progress_words
from capture_app.tui.jobs.runs import Runs
from capture_app.tui.widgets.picture import Source

SLOW_S = 60.0
"""Duration on all processors of this machine beyond which depth is not computed automatically again."""


async def begin(runs: Runs | None, sheet: TakeSheet) -> None:
    """Start the depth of a take's middle instant, and cancel an earlier depth that still waits.

    `runs` is None if depth is off, in all functions of this module. As with all runs, bursts have precedence.
    """
    if runs is None or len(sheet.cameras) < 2:
        return
    for run in [run for run in runs.all if run.kind == MOMENT.name]:
        if run.state is RunState.WAITING:
            await runs.cancel(run)
        elif run.state is RunState.NOT_APPLICABLE:
            await runs.forget(run)
    if not _is_slow(runs):
        runs.add(MOMENT, sheet.session.folder, f"--instant {sheet.instants // 2}")


def _is_slow(runs: Runs) -> bool:
    # Wall time would include waiting for other jobs.
    return any(
        run.kind == MOMENT.name and run.processor_s > SLOW_S * (os.cpu_count() or 1) for run in runs.all
    )


def run_of(runs: Runs | None, sheet: TakeSheet | None) -> Run | None:
    """Return the depth run of a take, or None."""
    found = [] if runs is None or sheet is None else runs.of(sheet.session.folder)
    return next((run for run in found if run.kind == MOMENT.name), None)


def lines(runs: Runs | None, sheet: TakeSheet | None) -> Iterator[Content]:
    """Yield lines with the depth's progress or result."""
    run = run_of(runs, sheet)
    if run is None:
        if runs is not None and sheet is not None and _is_slow(runs):
            yield Content.styled(
                f"no automatic depth: it takes over {SLOW_S:.0f} s here", "$foreground-muted"
            )
    elif not run.state.is_over:
        yield Content.styled(f"◔ depth {progress_words(run) or run.state}", "$primary")
    elif run.state is RunState.DONE:
        yield Content.styled(f"✔ {printable(run.message)}", "$success")
        yield Content.styled("d opens it in the browser", "$foreground-muted")
    else:
        yield Content.styled(f"depth {run.state}: {printable(run.message)}", "$foreground-muted")


def picture(runs: Runs | None, sheet: TakeSheet | None) -> Source | None:
    """Return the depth image of the middle camera, before that the depth of two cameras, or None."""
    run = run_of(runs, sheet)
    try:
        if run is not None and run.out is not None and not run.state.is_over:
            return (run.out / PAIR_DEPTH).read_bytes()
        return None if run is None or run.result is None else _depth_picture(run.result)
    except (*UNREADABLE, SimulshotError, OSError, LookupError, TypeError):
        return None


_depth_picture = lru_cache(maxsize=1)(depth_picture)
