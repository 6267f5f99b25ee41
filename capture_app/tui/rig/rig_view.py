"""Mode Rig: the rig's readiness with advice, its cameras, and its log."""

import asyncio
import contextlib
import re
import textwrap
from functools import partial
from pathlib import Path
from typing import ClassVar

from textual import work
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.content import Content

from capture_app.common.address import ANY_HOST, LOOPBACK_HOSTS, parse_address
from capture_app.common.camera_facts import PHONE
from capture_app.common.child import ask_reconstruct
from capture_app.common.errors import SimulshotError
from capture_app.common.node_state import NodeState
from capture_app.common.plugins import COMMANDS, load_plugin, plugin_names
from capture_app.common.stagger import EVEN, OFF, Stagger
from capture_app.common.text import printable
from capture_app.protocol.orders import AddCamera, RemoveCamera, StaggerCameras
from capture_app.protocol.status import LogLine, RigStatus
from capture_app.rig.process import start_rig
from capture_app.rig.rig_link import LinkLost, RigLink
from capture_app.tui.jobs.result_screen import open_report
from capture_app.tui.mode import ModeView
from capture_app.tui.question import Answer, Question, TextQuestion
from capture_app.tui.rig.camera_list import CameraList
from capture_app.tui.rig.guide_screens import GUIDES, Guide, GuideScreen, show_coverage
from capture_app.tui.rig.start import StartPanel
from capture_app.tui.rig_record import RecordChanged, RigRecord, showing_errors
from capture_app.tui.screen_settings import Settings
from capture_app.tui.signs import MISSING, NO_LEADER, rig_sign
from capture_app.tui.widgets.lines import Lines, log_lines

SCROLLBAR = 1
ADVICE_LINES = 2
_FIGURES = re.compile(r"[\d.,]+ ?[nµm]?s?")
SMALL = 30
"""Rows below which the log has two lines and no frame."""
CALM_S, MAX_CALM_S = 0.8, 10.0
"""Redraw interval of a synchronized rig in seconds: per camera, and maximum."""
REDRAW_S = 0.5
"""Redraw interval of changing numbers in seconds; a change of state is drawn at once."""


_OF_COMPANIONS = {"panel": GUIDES, "monitor": GUIDES, "phones": COMMANDS}
"""Groups of the plugins that actions need; each is named like its action."""


class RigView(ModeView):
    """View of all cameras, the rig's readiness, and its log."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(
            "delete,backspace",
            "remove",
            "Remove",
            id="rig.remove",
            key_display="del",
            tooltip="stop a camera, or remove a lost one",
        ),
        Binding("a", "add", "Add cameras", id="rig.add", tooltip="start or invite more cameras"),
        Binding(
            "T",
            "stagger",
            "Stagger",
            show=False,
            id="rig.stagger",
            tooltip="frames one after the other, or all at one instant",
        ),
        Binding("L", "log", "Log", id="rig.log", tooltip="scroll through the log"),
        Binding(
            "p",
            "guide('panel')",
            "Panel",
            id="rig.panel",
            tooltip="check the timing by a clock on a screen",
        ),
        Binding("h", "join('phones')", "Phones", id="rig.phones", tooltip="phones as cameras, by a QR code"),
        Binding(
            "g", "guide('monitor')", "Monitor", id="rig.monitor", tooltip="cameras and button on a phone"
        ),
        Binding(
            "i", "join('invite')", "Invite", show=False, id="rig.invite", tooltip="a code for another machine"
        ),
        Binding(
            "K",
            "coverage",
            "Board coverage",
            show=False,
            id="rig.coverage",
            tooltip="views of a calibration board that are missing, live",
        ),
        Binding(
            "G",
            "board",
            "Print a board",
            show=False,
            id="rig.board",
            tooltip="a calibration board to print at true size, as PDF",
        ),
        Binding("escape", "back", "Back", id="rig.back"),
    ]

    def __init__(
        self,
        source: RigLink,
        record: RigRecord,
        settings: Settings,
        sessions: Path,
        samples: Path | None,
        *,
        local: bool,
    ) -> None:
        """`local`: the leader is on this machine and can run its cameras; `samples`: as in `StartPanel`."""
        self._source, self._sessions, self._local = source, sessions, local
        self._record = record
        self._guides: dict[str, Guide] = {}
        self._advice = Lines(id="advice")
        self._cameras = CameraList(source, record)
        self._log_lines = Lines()
        self._event_log = VerticalScroll(self._log_lines, id="log")
        self._event_log.border_title = "log"
        self._start = StartPanel(source, settings, sessions, samples, local=local)
        self._adding: int | None = None
        """Number of cameras when the user chose to add more; None otherwise."""
        self._starting = ""
        """Message about the leader being started."""
        self._drawn: tuple[object, ...] = ()
        self._next_draw_s = 0.0
        super().__init__(self._advice, self._start, self._cameras, self._event_log)

    def on_mount(self) -> None:
        """Start the periodic redraws; the log follows its newest line until the user scrolls back."""
        self._event_log.anchor()
        self.set_interval(REDRAW_S, self._let_time_pass)

    def focus_first(self) -> None:
        """Focus the visible list."""
        if self._start.display:
            self._start.focus_first()
        else:
            self._cameras.rows.focus()

    def on_mode_shown(self) -> None:
        """Draw what happened while hidden."""
        super().on_mode_shown()
        self._draw()
        self._draw_log()

    def on_resize(self) -> None:
        """Divide the space again."""
        self.call_after_refresh(self.on_mode_shown)

    def on_record_changed(self, message: RecordChanged) -> None:
        """Draw changes at once, unless only numbers differ."""
        match message.what:
            case LogLine():
                self._draw_log()
            case LinkLost():
                self._drawn = ()
                self._draw()
                self.refresh_bindings()
            case RigStatus() as status:
                words = (status.advice, status.message, *(node.message for node in status.nodes))
                seen = (
                    *(_FIGURES.sub("", text) for text in words),
                    *((node.name, node.is_settled or node.state) for node in status.nodes),
                )
                if seen != self._drawn:
                    self._drawn = seen
                    self._draw()
                    self.refresh_bindings()

    def _let_time_pass(self) -> None:
        """Redraw at intervals; less often if only small phase changes are left."""
        status = self._record.status
        if status is None or self._record.clock() < self._next_draw_s:
            return
        # Calm: all connected cameras are synchronized, and only their phases fluctuate.
        is_calm = all(node.state is NodeState.LOST or node.is_settled for node in status.nodes)
        pause_s = min(max(CALM_S * len(status.nodes), REDRAW_S), MAX_CALM_S) if is_calm else 0.0
        self._next_draw_s = self._record.clock() + pause_s
        self._draw()

    def _draw(self) -> None:
        status = self._record.status
        if status is None or not self.screen.is_current or self.size.height == 0:
            return
        self._choose_panel(status)
        self._start.show_leader(status.leader)
        advice = [] if self._start.display and not self._record.lost else self._advise(status)
        self._advice.show(advice)
        # The log always has a few lines, and more in a large window.
        small = self.size.height < SMALL
        self.set_class(small, "-small")
        room = self.size.height - len(advice) - (3 if small else 8)
        self._cameras.styles.height = CameraList.rows_needed(len(status.nodes), room)
        self._cameras.draw(room)

    def _draw_log(self) -> None:
        self._log_lines.show(log_lines(self._record.log, self._event_log.size.width - SCROLLBAR))

    def _advise(self, status: RigStatus) -> list[Content]:
        if self._record.lost:
            sign, words = NO_LEADER, self._starting or self._record.lost
            if self._local and not self._starting:
                words = f"press l to restart it ({words.partition(';')[0]})"
        else:
            self._starting, sign = "", rig_sign(status)
            words = " ".join(filter(None, (status.message, status.advice))) or sign.word
            if sign.glyph == MISSING:
                words += "; del removes a lost camera"
        lines = textwrap.wrap(f"{sign.glyph} {printable(words)}", self.size.width - 2, subsequent_indent="  ")
        # A fixed number of lines, so that the content below does not jump.
        more, lines = lines[ADVICE_LINES:], (lines + [""] * ADVICE_LINES)[:ADVICE_LINES]
        if more:  # a truncated line shows that there is more
            lines[-1] += f" {more[0].strip()}"
        return [Content.styled(line, f"bold {sign.style}") for line in lines]

    def _choose_panel(self, status: RigStatus) -> None:
        """Show the start panel if there are no cameras, or while the user adds some."""
        if self._adding is not None and len(status.nodes) > self._adding:
            self._adding = None
        starting = not status.nodes or self._adding is not None
        if self._start.display != starting or self._cameras.display == starting:
            self._start.display = starting
            self._cameras.display = self._event_log.display = not starting
            self.focus_first()
            self.refresh_bindings()
            self.call_after_refresh(self.on_mode_shown)  # a widget has no size before it is displayed

    # Actions

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Return whether an action is available, given the companions, the visible panel and the focus."""
        name = str(*parameters) if action in ("guide", "join") else action
        if (group := _OF_COMPANIONS.get(name)) and name not in plugin_names(group):
            return False
        return {
            **dict.fromkeys(("add", "log", "guide", "join", "stagger"), self._cameras.display),
            "remove": self._cameras.rows.has_focus,
            "back": self._adding is not None or self._event_log.has_focus,
        }.get(action, True)

    def action_add(self) -> None:
        """Show the start panel to add cameras."""
        if self._record.status is not None:
            self._adding = len(self._record.status.nodes)
            self._start.say_busy("")
            self._draw()

    def action_back(self) -> None:
        """Show the cameras again, or leave the log, which follows its newest line again."""
        self._adding = None
        self._event_log.anchor()
        self._draw()
        self.focus_first()

    @work(exclusive=True, group="start")
    async def restart_leader(self) -> None:
        """Restart the local leader at its address, with the cameras that ended with it; others reconnect."""
        leader, status = self._source.leader, self._record.status
        alone = status is not None and parse_address(status.leader).host in LOOPBACK_HOSTS
        self._starting, connecting = f"starting a leader at {leader} …", ""
        self._draw()
        with showing_errors(self):
            await start_rig(
                sessions=self._sessions,
                host=(LOOPBACK_HOSTS if alone else ANY_HOST)[1],
                port=leader.port,
                stagger=Stagger.parse(status.stagger) if status is not None and status.stagger else None,
            )
            local = [
                AddCamera(spec=node.spec, name=node.name)
                for node in (status.nodes if status is not None else ())
                if node.spec
            ]
            await asyncio.gather(*(self._source.order(camera) for camera in local))
            connecting = f"the leader at {leader} runs again, connecting …"
        self._starting = connecting
        self._draw()

    def action_log(self) -> None:
        """Move the focus to the log for scrolling, or back."""
        if self._event_log.has_focus:
            self._event_log.anchor()
            self._cameras.rows.focus()
        else:
            self._event_log.focus()

    @work(group="orders")
    async def action_stagger(self) -> None:
        """Ask in which order the cameras take their frames, and set it."""
        now = "" if self._record.status is None else self._record.status.stagger
        text = await self.app.push_screen_wait(
            TextQuestion(
                f"{EVEN}: frames one after the other, in even steps. {OFF}: all at one instant."
                " Or a delay for each camera: cam0=0ms,cam1=8.3ms.",
                now or EVEN,
                check=Stagger.parse_or_off,
                title="Stagger",
            )
        )
        if text is not None:
            with showing_errors(self):
                stagger = Stagger.parse_or_off(text)
                await self._source.order(StaggerCameras(order=str(stagger or "")))

    def action_coverage(self) -> None:
        """Show live which views of a calibration board are missing."""
        guide = partial(show_coverage, self._source, self._record.status)
        self.app.push_screen(GuideScreen("coverage", "Calibration board", 60, guide))

    @work(group="board", exclusive=True)
    async def action_board(self) -> None:
        """Write the default calibration board to print, and open it."""
        page = self._sessions / "board.pdf"
        with contextlib.suppress(OSError):  # the command says why it cannot write there
            page.parent.mkdir(parents=True, exist_ok=True)
        with showing_errors(self):
            await ask_reconstruct(("board", str(page)), object)
            open_report(self, page)

    def action_guide(self, name: str) -> None:
        """Show a companion's instructions: how to check the rig with a panel, or to watch it on a phone."""
        with showing_errors(self):
            guide = self._guides.get(name)
            if guide is None:
                run = partial(self.app.run_worker, group=name, exit_on_error=False)
                plugin: type[Guide] = load_plugin(GUIDES, name, "TITLE", "WIDTH", "show")
                guide = self._guides[name] = plugin(self._source, is_local=self._local, run=run)
            self.app.push_screen(GuideScreen(name, guide.TITLE, guide.WIDTH, guide.show))

    def action_join(self, how: str) -> None:
        """Show how `phones` become cameras, or, for `invite`, how another machine joins the rig."""
        getattr(self._start, f"action_{how}")()

    @work(group="orders")
    async def action_remove(self) -> None:
        """Remove the selected camera from the rig."""
        node = self._cameras.rows.item
        if node is None:
            return
        with showing_errors(self):
            if node.state is not NodeState.LOST:
                if not node.on_leader and node.camera.kind != PHONE:
                    raise SimulshotError(
                        f"{node.camera.called(node.name)} runs on another machine, {node.address}",
                        hint="stop it there with Ctrl-C",
                    )
                answers = [Answer("keep", "k", "Keep"), Answer("end", "e", "Stop and remove")]
                question = Question(
                    f"{node.camera.called(node.name)} is running. Stop it and remove it from the rig?",
                    answers,
                )
                if await self.app.push_screen_wait(question) != "end":
                    return
            await self._source.order(RemoveCamera(name=node.name))
