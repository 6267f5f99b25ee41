"""One job: what it is to do, how far it is, and what has come of it."""

from collections import deque
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from pathlib import Path

from capture_app.text import ProgressStep
from capture_app.tui.jobs.kinds import JobKind

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
