"""The mode Jobs: what runs, waits and has been done, what each says, and the way to its results.

What a job says: the command line that does the same, what came of it, and its lines.
"""

from datetime import datetime
from functools import partial
from typing import ClassVar

from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.content import Content
from textual.strip import Strip
from textual.timer import Timer

from capture_app.errors import BadInputError
from capture_app.text import count, printable
from capture_app.tui.jobs.job import SIGNS, Job, JobState, progress_bar, progress_words, rough_time
from capture_app.tui.jobs.job_list import JobList
from capture_app.tui.jobs.result_screen import ResultScreen, open_report
from capture_app.tui.jobs.results import StudyResult, read_result
from capture_app.tui.mode import ModeView
from capture_app.tui.rig_record import Mishap
from capture_app.tui.widgets.lines import Lines, chosen_line, justified
from capture_app.tui.widgets.row_list import RowList

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


EMPTY = (
    "No job yet.",
    "In Sessions (key 3), c compares a take, e exports it, and a offers all that can be done with it.",
)


class JobRows(RowList):
    """The jobs, the newest first."""

    def __init__(self, jobs: JobList) -> None:
        super().__init__(2, id="jobs")
        self._jobs = jobs

    def job(self, key: str) -> Job | None:
        """The job of a row."""
        return next((job for job in self._jobs.jobs if str(job.number) == key), None)

    def draw_row(self, key: str, width: int, *, chosen: bool) -> list[Content | Strip]:
        """State, what, of which session; how far it is, or what came of it."""
        job = self.job(key)
        if job is None:
            return [Content("")] * self.row_height
        sign = SIGNS[job.state]
        when = _when(job.ended) if job.state.is_over else ""
        left = Content.assemble(
            (f" {sign.glyph} {sign.word:<{_WORD}} ", f"bold {sign.style}"),
            (f"{job.kind.title}  ", "bold"),
            (printable(job.session.name), "$foreground"),
        )
        first = justified(left, Content.styled(f"{when} ", "$foreground-muted"), width)
        if job.state.is_over:
            style = "$error" if job.state is JobState.FAILED else "$foreground-muted"
            second = Content.styled(f"{'':<{_INDENT}}{printable(job.message)}", style)
        else:
            bar = min(24, max(8, width // 5))
            second = Content.assemble(
                " " * _INDENT,
                progress_bar(job.share, bar),
                Content.styled(f" {progress_words(job)}", "$foreground-muted"),
            )
        lines = [first, second.truncate(width, ellipsis=True)]
        if chosen:
            lines = [chosen_line(line, width) for line in lines]
        return list(lines)


class JobsView(ModeView):
    """The jobs above what the chosen one says."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "open", "Results", id="jobs.open"),
        Binding("o", "report", "Report", id="jobs.report"),
        Binding("x", "cancel", "Cancel", id="jobs.cancel"),
        Binding("r", "retry", "Run again", id="jobs.retry"),
        Binding("delete,backspace", "forget", "Take off the list", id="jobs.forget", key_display="del"),
    ]
    DEFAULT_CSS = """
    JobsView #jobs-empty { padding: 1 2; color: $foreground-muted; }
    JobsView #jobs { height: 1fr; min-height: 4; border: round $border; border-title-color: $primary;
                     border-title-style: bold; border-subtitle-color: $foreground-muted; }
    JobsView #jobs:focus { border: round $primary; }
    JobsView JobLog { height: 40%; min-height: 5; }
    """

    def __init__(self, jobs: JobList) -> None:
        super().__init__()
        self._jobs = jobs
        self._rows = JobRows(jobs)
        self._empty = Lines(id="jobs-empty")
        self._log = JobLog()
        self._tick: Timer | None = None

    def compose(self) -> ComposeResult:
        """The list above the log."""
        self._rows.border_title = "jobs"
        yield self._empty
        yield self._rows
        yield self._log

    def on_mount(self) -> None:
        """Follow the jobs."""
        self._stop_watching = self._jobs.watch(lambda job: self._show(job))
        self._tick = self.set_interval(1.0, self._show_time, pause=True)
        self._empty.show([Content(line) for line in EMPTY])
        self._show()

    def on_unmount(self) -> None:
        """Follow them no longer."""
        self._stop_watching()

    def focus_first(self) -> None:
        """The list is what is driven here."""
        (self._rows if self._jobs.jobs else self).focus()

    def on_focus(self) -> None:
        """Pass the focus on, too, where the jobs were found just before it came."""
        self.focus_first()

    @property
    def chosen(self) -> Job | None:
        """The job under the cursor."""
        return self._rows.job(self._rows.chosen)

    def choose(self, job: Job) -> None:
        """Put the cursor on a job."""
        self._rows.choose(str(job.number))

    # Showing

    def _show(self, changed: Job | None = None) -> None:
        jobs = self._jobs.jobs
        self._empty.display = not jobs
        self._rows.display = self._log.display = bool(jobs)
        if jobs and self.has_focus:
            self._rows.focus()
        self._rows.show_rows([str(job.number) for job in jobs])
        if changed is not None:
            self._rows.show_again(str(changed.number))
        unfinished = len(self._jobs.unfinished)
        held = " · paused: a burst has the machine to itself" if self._jobs.is_held and unfinished else ""
        self._rows.border_subtitle = f"{unfinished} to do{held}" if unfinished else count(len(jobs), "job")
        if self._tick is not None:
            (self._tick.resume if unfinished else self._tick.pause)()
        if changed is None or changed is self.chosen:
            self._log.show(self.chosen)
        self.refresh_bindings()

    def _show_time(self) -> None:
        """The time that is left goes on between a job's lines."""
        for job in self._jobs.unfinished:
            self._jobs.seconds_of(job)
            self._rows.show_again(str(job.number))
        chosen = self.chosen
        if chosen is not None and not chosen.state.is_over:
            self._log.show_time(chosen)

    def on_row_list_chosen(self) -> None:
        """Show what that job says."""
        self._log.show(self.chosen)
        self.refresh_bindings()

    def on_row_list_opened(self, message: RowList.Opened) -> None:
        """Show the results."""
        message.stop()
        self.action_open()

    # Doing

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer only what can be done with the chosen job."""
        job = self.chosen if self.is_mounted else None
        over = job is not None and job.state.is_over
        return {
            "open": job is not None and job.result is not None,
            "report": job is not None and job.report is not None,
            "cancel": job is not None and not over,
            "retry": over,
            "forget": over,
        }.get(action, True)

    @work
    async def action_open(self) -> None:
        """Show what the chosen job has found."""
        if self.chosen is not None and self.chosen.result is not None:
            await show_result(self, self.chosen)

    def action_report(self) -> None:
        """Open the chosen job's report in the browser."""
        if self.chosen is not None:
            open_report(self, self.chosen.report)

    @work
    async def action_cancel(self) -> None:
        """End the chosen job."""
        if self.chosen is not None:
            await self._jobs.cancel(self.chosen)

    def action_retry(self) -> None:
        """Do the chosen job again."""
        if self.chosen is not None:
            try:
                self.choose(self._jobs.retry(self.chosen))
            except BadInputError as error:
                self.post_message(Mishap(error))

    def action_forget(self) -> None:
        """Take the chosen job off the list; its results stay."""
        if self.chosen is not None:
            self._jobs.forget(self.chosen)


async def load_result(view: ModeView, job: Job) -> StudyResult | None:
    """Read a job's result in a thread; None, and a sentence on the screen, where that fails."""
    reading = view.run_worker(partial(read_result, job), thread=True, exit_on_error=False)
    try:
        return await reading.wait()
    except Exception as error:  # noqa: BLE001 - a worker's error is wrapped
        cause = error.__cause__ or getattr(reading, "error", None) or error
        view.post_message(Mishap(cause if isinstance(cause, Exception) else error))
        return None


async def show_result(view: ModeView, job: Job) -> None:
    """Show a job's result on the whole screen."""
    result = await load_result(view, job)
    if result is not None:
        await view.app.push_screen(ResultScreen(job, result))


_WORD = 9
_INDENT = 4


def _when(moment: datetime | None) -> str:
    return "" if moment is None else moment.astimezone().strftime("%d %b %H:%M")
