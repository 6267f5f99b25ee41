"""One job: what it is to do, how far it is, and what has come of it.

The kinds of jobs: the command line of each, and settings that are quick and still tell.

The state of a job as a word, a glyph and a colour; and how far it is.
"""

import shlex
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from pathlib import Path

from textual.content import Content

from capture_app.errors import BadInputError
from capture_app.session.exporters.export_session import FORMATS
from capture_app.text import ProgressStep, printable
from capture_app.tui.signs import Sign
from capture_app.tui.widgets.lines import filled_cells

CAPTURE, RECONSTRUCT = "capture_app.cli", "reconstruction.cli"
_PROGRAMS = {CAPTURE: "capture-app", RECONSTRUCT: "reconstruct"}


@dataclass(frozen=True, slots=True)
class JobKind:
    """One thing that can be done with a session in a process of its own."""

    name: str
    title: str
    what: str
    """What one gets of it, in a sentence."""
    module: str
    command: tuple[str, ...]
    quick: str = ""
    """Options that make it quick; a user may change them."""
    writes: bool = True
    """It writes a folder, which it is given by --out."""
    result: str = ""
    """The file of its folder that holds its figures; empty where there is nothing to look at."""
    report: str = ""
    """The file of its folder that a browser shows; empty where it writes none."""
    fixed: tuple[str, ...] = field(default=())

    def arguments(self, session: Path, out: Path | None, options: str) -> tuple[str, ...]:
        """The command line after the program's name. Raises BadInputError for options that are no words."""
        try:
            words = shlex.split(options)
        except ValueError as error:
            raise BadInputError(f"the options cannot be read: {error}", hint="close all quotes") from None
        for word in words:
            if word.partition("=")[0] in ("--out", "--json"):
                raise BadInputError(f"{word} is set by the job itself", hint="leave it out")
        target = () if out is None or not self.writes else ("--out", str(out))
        return (*self.command, str(session), *self.fixed, *words, *target, "--json")

    def command_line(self, session: Path, out: Path | None, options: str) -> str:
        """What one would type to do the same."""
        words = self.arguments(session, out, options)[:-1]
        return shlex.join((_PROGRAMS.get(self.module, self.module), *words))


COMPARE = JobKind(
    "compare",
    "Compare",
    "what synchronization is worth in this take",
    RECONSTRUCT,
    ("compare",),
    "--max-multiview-instants 3 --multiview-width 320",
    result="metrics.json",
    report="report.html",
)
MULTIVIEW = JobKind(
    "multiview",
    "Depth from all cameras",
    "depth maps and a point cloud of one instant",
    RECONSTRUCT,
    ("multiview",),
    "--instant 0 --no-mesh",
    result="multiview.json",
)
CLOUDS = JobKind(
    "clouds",
    "Clouds of all instants",
    "a cloud of each, and masks of what moves",
    RECONSTRUCT,
    ("multiview",),
    result="sequence.json",
    fixed=("--instants", "all"),
)
STITCH = JobKind(
    "stitch",
    "Panorama",
    "one wide picture, of one instant and late",
    RECONSTRUCT,
    ("panorama",),
    "--instant 0 --offset-ms 66",
    result="metrics.json",
)
DOSE = JobKind(
    "dose",
    "Tolerable delay",
    "how late a camera may be for good depth",
    RECONSTRUCT,
    ("tolerance",),
    "--max-instants 4",
    result="metrics.json",
    report="report.html",
)
PANEL = JobKind(
    "panel",
    "Panel",
    "how far apart the cameras were, by a panel",
    CAPTURE,
    ("panel", "read"),
    result="panel.json",
)
VERIFY = JobKind(
    "verify",
    "Verify",
    "whether every file is as it was saved",
    CAPTURE,
    ("sessions", "verify"),
    writes=False,
)
REPAIR = JobKind(
    "repair",
    "Repair",
    "finish it with the images that are there",
    CAPTURE,
    ("sessions", "repair"),
    "--wait-s 0",
    writes=False,
)
EXPORTS: Mapping[str, JobKind] = {
    name: JobKind(
        f"export-{name}",
        f"Export to {name}",
        what,
        CAPTURE,
        ("sessions", "export"),
        fixed=("--to", name),
    )
    for name, what in FORMATS.items()
}
STUDIES = (COMPARE, MULTIVIEW, STITCH, DOSE, CLOUDS, PANEL)
"""The jobs whose results can be looked at."""
KINDS: Mapping[str, JobKind] = {kind.name: kind for kind in (*STUDIES, VERIFY, REPAIR, *EXPORTS.values())}


LOG_LINES = 500
MEASURED_SHARE = 1 / 3
"""From this share of a job's steps on its pace tells how long the others take."""


class JobState(StrEnum):
    """Where a job is."""

    WAITING = "waiting"
    RUNNING = "running"
    PAUSED = "paused"
    """A burst is taken or saved, and has the machine to itself."""
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def is_over(self) -> bool:
        """Whether nothing more will happen of itself."""
        return self in (JobState.DONE, JobState.FAILED, JobState.CANCELLED)


@dataclass(eq=False, slots=True)
class Job:
    """A job of this run, or one of an earlier run that was found on disk."""

    kind: JobKind
    session: Path
    out: Path | None
    options: str
    number: int
    state: JobState = JobState.WAITING
    step: ProgressStep | None = None
    message: str = ""
    """What came of it in a sentence: the verdict, what was written, or what went wrong."""
    ended: datetime | None = None
    seconds: float = 0.0
    """How long it has run, without the time for which it was paused."""
    is_found: bool = False
    """It is of an earlier run of the screen, and was found on disk."""
    log: deque[str] = field(default_factory=lambda: deque(maxlen=LOG_LINES))

    @property
    def place(self) -> Path:
        """The session's folder, however it was named when the job was started."""
        return self.session.absolute()

    @property
    def command_line(self) -> str:
        """What one would type to do the same."""
        return self.kind.command_line(self.session, self.out, self.options)

    @property
    def result(self) -> Path | None:
        """The file with the figures, its own or those of an earlier run to the same folder, if any."""
        if not self.state.is_over or self.out is None or not self.kind.result:
            return None
        path = self.out / self.kind.result
        return path if path.is_file() else None

    @property
    def report(self) -> Path | None:
        """The report that comes with the result, if any."""
        result = self.result
        if result is None or not self.kind.report:
            return None
        path = result.with_name(self.kind.report)
        return path if path.is_file() else None

    @property
    def share(self) -> float | None:
        """How much of it is done, 0 to 1, by its steps; None where that is not known."""
        if self.state is JobState.DONE:
            return 1.0
        if self.step is None or self.step.total <= 0:
            return None
        # A line tells the step that begins.
        return min(1.0, max(0.0, (self.step.done - 1) / self.step.total))

    @property
    def standing(self) -> str:
        """What it is of, and how far it is: Compare of burst-001 (11 %)."""
        waits = self.state is JobState.WAITING or self.share is None
        far = str(self.state) if waits else f"{100 * (self.share or 0.0):.0f} %"
        return f"{self.kind.title} of {self.session.name} ({far})"

    @property
    def seconds_left(self) -> float | None:
        """How long it will take yet, were all its steps alike; None before a third of them is done."""
        share = self.share
        # The first steps are the shortest ones: by them alone a quarter of an hour looks like seconds.
        if share is None or share < MEASURED_SHARE or self.state.is_over:
            return None
        return self.seconds * (1 - share) / share


SIGNS = {
    JobState.WAITING: Sign("○", "waiting", "$foreground-muted"),
    JobState.RUNNING: Sign("▶", "running", "$primary"),
    JobState.PAUSED: Sign("⏸", "paused", "$warning"),
    JobState.DONE: Sign("✔", "done", "$success"),
    JobState.FAILED: Sign("✖", "failed", "$error"),
    JobState.CANCELLED: Sign("◌", "cancelled", "$foreground-muted"),
}


def rough_time(seconds: float) -> str:
    """A time to wait or waited, as roughly as it is known: 8 s, 2 min, 1 h 20 min."""
    if seconds < 99.5:
        return f"{max(1, round(seconds))} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"


def progress_bar(share: float | None, width: int) -> Content:
    """A bar of cells that is filled as far as the share."""
    full = filled_cells(share or 0.0, width)
    return Content.assemble((full, "$primary"), ("─" * (width - len(full)), "$border"))


def progress_words(job: Job) -> str:
    """How far it is, in words: 43 % · 2 min left · stereo cam00-cam01."""
    parts = []
    if job.share is not None and not job.state.is_over:
        parts.append(f"{100 * job.share:.0f} %")
    if (left := job.seconds_left) is not None:
        parts.append(f"about {rough_time(left)} left")
    if job.step is not None and not job.state.is_over:
        parts.append(printable(job.step.text))
    return " · ".join(parts)


def job_tag(job: Job) -> Content:
    """What a list of sessions says of a job: its glyph, and how far it is."""
    sign = SIGNS[job.state]
    share = f" {100 * job.share:.0f} %" if job.share is not None and not job.state.is_over else ""
    return Content.styled(f"{sign.glyph} {job.kind.title.lower()}{share}", sign.style)
