"""The terminal UI: one screen that shows the cameras, takes bursts and compares sessions."""

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

from rich.text import Text
from textual import work
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container, Horizontal, Vertical
from textual.widgets import Footer, Label, ProgressBar, RichLog, Static

from capture_app.errors import SimulshotError
from capture_app.node.leader.snapshots import in_tree_order
from capture_app.node.wire.status import RigStatus
from capture_app.session.reading.reader import Session
from capture_app.sync.wire.messages import NodeState
from capture_app.text import ProgressStep, printable
from capture_app.tui.live import Comparison, LiveRig, Rig
from capture_app.tui.tables import NodesTable, SessionsTable, describe_manifest

REFRESH_S = 0.25
BURST_FRAMES = 5
SIMULATED_CAMERAS = 5
TAKING = "taking a burst"


class RigApp(App[None]):
    """Shows snapshots of a rig and asks it for bursts; all it knows is in the snapshot."""

    TITLE = "simulshot"
    CSS_PATH = "app.tcss"
    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (110, "-wide")]  # noqa: RUF012 - Textual's own name and type
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("b", "burst", "Burst"),
        Binding("c", "compare", "Compare"),
        Binding("o", "open_report", "Open report"),
        Binding("s", "simulate", "Simulated cameras"),
        Binding("q", "quit", "Quit"),
    ]

    def __init__(self, rig: Rig) -> None:
        super().__init__()
        self._rig = rig
        self._known_sessions: set[str] = set()
        self._reports: dict[Path, Path] = {}
        self._busy = ""

    def compose(self) -> ComposeResult:
        """Lay the screen out."""
        yield Static(id="headline")
        with Vertical(id="cameras") as cameras:
            cameras.border_title = "Cameras"
            yield Static(id="empty")
            yield NodesTable(id="nodes")
        with Container(id="lower"):
            with Vertical(id="saved") as saved:
                saved.border_title = "Sessions"
                yield SessionsTable(id="sessions")
            with Vertical(id="news") as news:
                news.border_title = "Events"
                yield RichLog(id="log", wrap=True, min_width=0, markup=False, max_lines=500)
        with Horizontal(id="doing", classes="idle"):
            yield Label(id="message")
            yield ProgressBar(id="progress", show_eta=False)
        yield Footer()

    def on_mount(self) -> None:
        """Begin to show the rig."""
        self._rig.on_news(self._log_event)
        self.query_one(SessionsTable).focus()
        self.show_rig()
        self.set_interval(REFRESH_S, self.show_rig)

    def on_unmount(self) -> None:
        """Stop logging events: nodes still leave when the screen has closed."""
        self._rig.on_news(lambda _: None)

    # Showing

    def show_rig(self) -> None:
        """Show the rig as it is now; does nothing while the screen closes."""
        if not self.query(SessionsTable) or not self.query("#headline"):
            return
        status = self._rig.status()
        self.query_one("#headline", Static).update(_headline(status))
        empty = self.query_one("#empty", Static)
        table = self.query_one(NodesTable)
        empty.update(_how_to_join(status))
        empty.display = not status.nodes
        table.display = bool(status.nodes)
        table.show(tuple(in_tree_order(status.nodes)), wide=self.size.width >= 110)
        burst = status.burst
        if self._busy == TAKING and burst is not None and not burst.done:
            text = f"saving {burst.name}: {burst.received} of {burst.expected} images"
            self._show_message(text, progress=ProgressStep(burst.received, burst.expected, text))
        for path in status.sessions:
            if path not in self._known_sessions:
                self._known_sessions.add(path)
                self._show_session(Path(path))

    @work(thread=True)
    def _show_session(self, path: Path) -> None:
        try:
            images, sync = describe_manifest(Session.open(path).manifest)
        except SimulshotError as error:
            self.call_from_thread(self._log_event, str(error))
            return
        self.call_from_thread(self.query_one(SessionsTable).add_session, path, images, sync)

    def _log_event(self, line: str) -> None:
        self.query_one(RichLog).write(printable(line))

    def _show_message(self, text: str, *, error: bool = False, progress: ProgressStep | None = None) -> None:
        self.query_one("#message", Label).update(Text(printable(text), style="red" if error else ""))
        bar = self.query_one(ProgressBar)
        if progress is not None:
            bar.update(total=progress.total, progress=progress.done)
        self.query_one("#doing").set_class(progress is None, "idle")

    # Doing

    def _is_busy(self) -> bool:
        if self._busy:
            self._show_message(f"please wait: {self._busy}")
        return bool(self._busy)

    @contextmanager
    def _busy_with(self, what: str) -> Iterator[None]:
        """Show what is under way, and its error where it fails."""
        self._busy = what
        self._show_message(f"{what} …")
        try:
            yield
        except SimulshotError as error:
            self._show_message(str(error), error=True)
        finally:
            self._busy = ""

    @work
    async def action_burst(self) -> None:
        """Take a burst with all cameras."""
        if self._is_busy():
            return
        with self._busy_with(TAKING):
            burst = await self._rig.burst(BURST_FRAMES)
            saved = f"saved {burst.name}: {burst.received} of {burst.expected} images"
            self._show_message(burst.message or saved)

    @work
    async def action_simulate(self) -> None:
        """Start simulated cameras on this machine."""
        if self._is_busy():
            return
        with self._busy_with("starting simulated cameras"):
            await self._rig.add_simulated(SIMULATED_CAMERAS)
            self._show_message(
                f"started {SIMULATED_CAMERAS} simulated cameras; synchronizing takes some seconds"
            )

    @work
    async def action_compare(self) -> None:
        """Compare synchronized with delayed frames of the selected session."""
        sessions = self.query_one(SessionsTable)
        session = sessions.selected
        if session is None:
            self._show_message("no session yet: press b to take a burst")
            return
        if self._is_busy():
            return
        with self._busy_with(f"comparing {session.name}"):
            try:
                async for step in self._rig.compare(session):
                    if isinstance(step, Comparison):
                        self._reports[session] = step.report
                        sessions.show_comparison(session, "press o for the report", "green")
                        self._log_event(step.verdict)
                        self._show_message(f"report: {step.report}")
                    else:
                        sessions.show_comparison(session, f"{step.done} of {step.total}", "yellow")
                        self._show_message(step.text, progress=step)
            except SimulshotError:
                sessions.show_comparison(session, "failed", "red")
                raise

    def action_open_report(self) -> None:
        """Open the selected session's report in the browser."""
        session = self.query_one(SessionsTable).selected
        report = None if session is None else self._reports.get(session)
        if report is None:
            self._show_message("no report yet: press c to compare the selected session")
            return
        self._show_message(f"report: {report}")
        self.open_url(report.resolve().as_uri())


def _headline(status: RigStatus) -> Text:
    text = Text("simulshot", style="bold")
    text.append(f"   leader {status.leader}", style="not bold")
    if status.period_ns:
        text.append(f"   {1e9 / status.period_ns:.1f} fps", style="not bold")
    here = [node for node in status.nodes if node.state is not NodeState.LOST]
    ready = sum(node.state is NodeState.READY for node in here)
    if here:
        done = ready == len(here)
        text.append(f"   {ready} of {len(here)} ready", style="bold green" if done else "bold yellow")
        if done:
            text.append("   press b", style="not bold")
    return text


def _how_to_join(status: RigStatus) -> Text:
    text = Text("No camera has joined yet. On the computer of each camera, run:\n\n")
    text.append(f"  capture-app node --leader {status.leader} --camera v4l2:/dev/video0\n\n", style="bold")
    text.append("Or press ")
    text.append("s", style="bold")
    text.append(f" for {SIMULATED_CAMERAS} simulated cameras on this machine.")
    return text


def run_app(*, sessions: Path, host: str, port: int) -> None:
    """Open the screen over a leader of its own until it is closed.

    Raises NetworkError where the port is in use, before anything is drawn.
    """

    async def opened() -> None:
        async with LiveRig(sessions=sessions, host=host, port=port) as rig:
            await RigApp(rig).run_async()

    asyncio.run(opened())
