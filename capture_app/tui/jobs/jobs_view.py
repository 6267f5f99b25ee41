"""Mode Jobs: running, waiting and finished runs, their output, and access to their results."""

from collections.abc import Sequence
from typing import ClassVar

from textual import work
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.content import Content
from textual.strip import Strip

from capture_app.common.text import count, printable, rough_time
from capture_app.tui.jobs.result_screen import open_report, show_result
from capture_app.tui.jobs.run import CAN_EXPORT, SIGNS, Run, RunState, progress_words
from capture_app.tui.jobs.runs import Runs
from capture_app.tui.mode import ModeView
from capture_app.tui.rig_record import RecordChanged, showing_errors
from capture_app.tui.widgets.lines import Lines, chosen_line, filled_cells, justified, write_border
from capture_app.tui.widgets.row_list import RowList

SHOWN = 100
"""Max log lines shown; the complete log is in a file beside the results."""
LOOK_EVERY_S = 0.25
"""Redraw interval in seconds: a program may print a thousand lines a second."""
_STATE_WIDTH, _INDENT = 14, 4


def draw_run(run: Run, width: int, chosen: bool) -> Sequence[Content | Strip]:
    """Draw a run in two lines: state, command and session; progress or outcome."""
    sign = SIGNS[run.state]
    when = "" if run.ended is None else run.ended.astimezone().strftime("%d %b %H:%M")
    left = Content.assemble(
        (f" {sign.glyph} {sign.word:<{_STATE_WIDTH}} ", f"bold {sign.style}"),
        (f"{run.command.title}  ", "bold"),
        (printable(run.session.name), "$foreground"),
    )
    first = justified(left, Content.styled(f"{when} ", "$foreground-muted"), width)
    if run.state.is_over or run.is_foreign:
        style = "$error" if run.state is RunState.FAILED else "$foreground-muted"
        second = Content.styled(f"{'':<{_INDENT}}{printable(run.message)}", style)
    else:
        bar = min(24, max(8, width // 5))
        full = filled_cells(run.fraction or 0.0, bar)
        second = Content.assemble(
            " " * _INDENT,
            (full, "$primary"),
            ("─" * (bar - len(full)), "$border"),
            (f" {progress_words(run)}", "$foreground-muted"),
        )
    lines = first, second.truncate(width, ellipsis=True)
    return [chosen_line(line, width) for line in lines] if chosen else lines


class JobsView(ModeView):
    """List of runs above the output of the selected one."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "on_run('open')", "Results", id="jobs.open"),
        Binding("o", "on_run('report')", "Report", id="jobs.report"),
        Binding("x", "on_run('cancel')", "Cancel", id="jobs.cancel"),
        Binding("r", "on_run('retry')", "Again", id="jobs.retry", tooltip="run the job again"),
        Binding("delete,backspace", "on_run('forget')", "Remove", id="jobs.forget", key_display="del"),
    ]

    def __init__(self, runs: Runs) -> None:
        self._runs = runs
        self._rows = RowList(2, draw_run, id="jobs")
        self._empty = Lines(id="jobs-empty")
        self._lines = Lines(id="job-lines")
        self._log = VerticalScroll(self._lines, id="job-log")
        self._logged: Run | None = None
        super().__init__(self._empty, self._rows, self._log)
        self._rows.border_title = "jobs"

    def on_mount(self) -> None:
        """Start following the runs."""
        self.set_interval(LOOK_EVERY_S, self._follow)
        hint = (
            f"In Sessions (key 3): c compares a take,{' e exports it,' * CAN_EXPORT} "
            "A starts other computations."
        )
        self._empty.show([Content("No job yet."), Content(hint)])

    def focus_first(self) -> None:
        """Focus the list; the view itself if there are no runs."""
        (self._rows if self._runs.all else self).focus()

    on_focus = focus_first

    def on_mode_shown(self) -> None:
        """Draw what happened while hidden."""
        super().on_mode_shown()
        self._show()

    def on_resize(self) -> None:
        """Wrap the log to the new width."""
        self.call_after_refresh(self._show_log)

    def on_record_changed(self, message: RecordChanged) -> None:
        """Update the runs after a change of state."""
        if message.what is self._runs:
            self._show()

    # Drawing

    def _show(self) -> None:
        runs, unfinished = self._runs.all, len(self._runs.unfinished)
        self._empty.display = not runs
        self._rows.display = self._log.display = bool(runs)
        if runs and self.has_focus:
            self._rows.focus()
        self._rows.show_items({run.key: run for run in runs})
        held = " · paused while a burst is taken or saved" if self._runs.are_held and unfinished else ""
        jobs = f"{unfinished} to do{held}" if unfinished else count(len(runs), "job")
        write_border(self._rows, None, jobs)
        if self._log.size.width:
            self._show_log()
        else:
            # It has no width to wrap to before it is laid out.
            self.call_after_refresh(self._show_log)
        self.refresh_bindings()

    def _follow(self) -> None:
        """Update times, steps and output between changes of state."""
        self._runs.count_time()
        for run in self._runs.unfinished:
            self._rows.show_again(run.key)
            if run is self._rows.item:
                self._show_log()

    def _show_log(self) -> None:
        run, before = self._rows.item, self._logged
        if not self.is_attached or run is None:
            return
        self._logged = run
        at_end = self._log.max_scroll_y - self._log.scroll_offset.y < 2
        width = max(20, self._log.scrollable_content_region.width)
        lines = Content.styled(f"$ {printable(run.line)}", "$foreground-muted").wrap(width)
        if run.message:
            lines += Content(printable(run.message)).wrap(width)
        if said := list(self._runs.log(run))[-SHOWN:]:
            lines += Content.styled("\n".join(["", *said]), "$foreground-muted").wrap(width)
        self._lines.show(lines)
        elapsed = (rough_time(run.seconds),) if run.seconds >= 1 else ()
        state = " · ".join((str(SIGNS[run.state]), *elapsed))
        write_border(self._log, printable(f"{run.command.title} · {run.session.name}"), state)
        if run is not before:
            self._log.scroll_home(animate=False)
        elif at_end and not run.state.is_over:
            self._log.scroll_end(animate=False)

    def on_row_list_chosen(self, message: RowList.Chosen) -> None:
        """Show the selected run's output, or open its results."""
        self._show_log()
        self.refresh_bindings()
        if message.opens and self.check_action("on_run", ("open",)):
            self.action_on_run("open")

    # Actions

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer only actions available for the selected run."""
        run = self._rows.item if self.is_mounted else None
        over = run is not None and run.state.is_over
        return {
            "open": run is not None and run.result is not None,
            "report": run is not None and run.report is not None,
            "cancel": run is not None and not over and not run.is_foreign,
            "retry": over,
            "forget": over,
        }.get(str(*parameters), True)

    @work
    async def action_on_run(self, what: str) -> None:
        """Do something with the selected run, for which it is offered."""
        run = self._rows.item
        if run is None:
            return
        match what:
            case "open":
                await show_result(self, run, self._runs.log(run))
            case "report":
                open_report(self, run.report)
            case "cancel":
                await self._runs.cancel(run)
            case "retry":
                with showing_errors(self):
                    self._rows.choose(self._runs.add(run.command, run.session, run.options, run.out).key)
            case "forget":
                await self._runs.forget(run)
