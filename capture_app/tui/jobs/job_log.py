"""What a job says: the command line that does the same, what came of it, and its lines."""

from textual.containers import VerticalScroll
from textual.content import Content

from capture_app.text import printable
from capture_app.tui.drawing.lines import Lines
from capture_app.tui.jobs.job import Job
from capture_app.tui.jobs.signs import SIGNS, rough_time

SHOWN = 100
"""The most lines of a log that are shown; all are in its file beside the results."""


class JobLog(VerticalScroll):
    """Shows one job, and follows its end while it runs."""

    DEFAULT_CSS = """
    JobLog { border: round $border; padding: 0 1; border-title-color: $primary; border-title-style: bold;
             border-subtitle-color: $foreground-muted; scrollbar-size-vertical: 1; }
    JobLog:focus { border: round $primary; }
    """

    def __init__(self) -> None:
        super().__init__(id="job-log")
        self._job: Job | None = None
        self._lines = Lines(id="job-lines")

    def compose(self) -> "list[Lines]":
        """The lines, which scroll."""
        return [self._lines]

    def show(self, job: Job | None) -> None:
        """Show a job as it is now."""
        other, self._job = job is not self._job, job
        if not self.is_attached:
            return
        at_end = self.max_scroll_y - self.scroll_offset.y < 2
        self._lines.show([] if job is None else self._describe(job))
        if job is not None:
            self.show_time(job)
        if other:
            self.scroll_home(animate=False)
        elif at_end and job is not None and not job.state.is_over:
            self.scroll_end(animate=False)

    def show_time(self, job: Job) -> None:
        """Show how long it has run."""
        time = f" · {rough_time(job.seconds)}" if job.seconds >= 1 else ""
        title = Content(printable(f"{job.kind.title} · {job.session.name}"))
        if self.border_title != title.markup:
            self.border_title = title
        self.border_subtitle = f"{SIGNS[job.state]}{time}"

    def on_resize(self) -> None:
        """Wrap anew."""
        self.show(self._job)

    def _describe(self, job: Job) -> list[Content]:
        width = max(20, self.scrollable_content_region.width)
        lines = Content.styled(f"$ {printable(job.command_line)}", "$foreground-muted").wrap(width)
        if job.message:
            lines += Content(printable(job.message)).wrap(width)
        if job.log:
            last = list(job.log)[-SHOWN:]
            said = (Content.styled(printable(line), "$foreground-muted").wrap(width) for line in last)
            lines += [Content(""), *(line for wrapped in said for line in wrapped)]
        return lines
