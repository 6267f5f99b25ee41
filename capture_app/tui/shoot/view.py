"""The mode Shoot: Space takes; what the cameras see beside the plan, then at once the contact sheet.

What ends a take: the key that takes a burst back, ahead or being saved, and the end of a recording.

What is asked before a take: whether to wait for cameras that still sync, and whether to keep the last.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import Any, ClassVar

from msgspec.structs import replace
from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.content import Content
from textual.widgets import Static
from textual.worker import Worker, get_current_worker

from capture_app.errors import SimulshotError
from capture_app.node.rig_link import RigLink
from capture_app.node.wire.messages import BurstRequest
from capture_app.node.wire.status import BurstStatus, NodeStatus, RigStatus
from capture_app.session.library.trash import trash_session
from capture_app.sync.wire.messages import NodeState
from capture_app.text import clock_offset, count, duration, printable
from capture_app.tui.mode import ModeView
from capture_app.tui.question import CANCEL, Answer, Question
from capture_app.tui.rig_record import Mishap, PreviewReceived, StatusChanged
from capture_app.tui.settings import Settings
from capture_app.tui.shoot.plan import PlanPanel
from capture_app.tui.shoot.stage import Moment, Shooting, Stage
from capture_app.tui.shoot.takes import (
    JudgedTake,
    StatusLine,
    Take,
    TakeLog,
    TakePanel,
    describe_failure,
    judge_take,
    verdict_line,
)
from capture_app.tui.signs import cameras_of

MOST_ANSWERS = 9
"""As many as there are keys for."""


class BurstControl(ModeView):
    """A mode in which bursts can be cancelled, and recordings ended."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(
            "x",
            "cancel_burst",
            "Cancel a burst",
            id="shoot.cancel",
            show=False,
            tooltip="ahead, or being saved",
        ),
    ]
    _rig: RigLink
    _status: RigStatus | None

    def action_cancel_burst(self) -> None:
        """Ask which burst to cancel, and cancel it."""
        offers = {} if self._status is None else cancellable_bursts(self._status)
        if not offers:
            self.notify("no burst lies ahead, and none is being saved")
            return
        answers = [
            Answer(str(burst), str(key), words)
            for key, (burst, words) in enumerate(list(offers.items())[:MOST_ANSWERS], 1)
        ]

        def cancel(answer: str | None) -> None:
            if answer is not None:
                self._order(self._rig.cancel_burst(int(answer)))

        text = "What has come of it already is saved."
        self.app.push_screen(Question(text, [*answers, CANCEL], title="Cancel a burst"), cancel)

    def end_recording(self) -> bool:
        """End the recording that is under way; whether there is one."""
        newest = None if self._status is None else self._status.burst
        if newest is None or not newest.recording or newest.done:
            return False
        self._order(self._rig.end_burst(newest.burst))
        return True

    @work(group="orders")
    async def _order(self, order: Awaitable[None]) -> None:
        try:
            await order
        except SimulshotError as error:
            self.post_message(Mishap(error))


def cancellable_bursts(status: RigStatus) -> dict[int, str]:
    """The bursts that can be cancelled, by number, in words: the one being saved, then those ahead."""
    offers = {}
    newest = status.burst
    ahead = sorted(status.ahead, key=lambda burst: burst.first_leader_ns)
    if newest is not None and newest.burst and not newest.done:
        offers[newest.burst] = f"{newest.name}: {newest.received} of {newest.expected} images are here"
    for burst in ahead:
        begins = clock_offset(max(0, burst.first_leader_ns - status.now_ns), signed=False)
        offers[burst.burst] = f"{burst.name}: begins in {begins}, {count(burst.instants, 'frame')}"
    return offers


ANYWAY = (Answer("wait", "w", "Wait, then take"), Answer("take", "t", "Take now"), CANCEL)
AGAIN = (Answer("keep", "k", "Keep, take again"), Answer("trash", "t", "Trash, take again"), CANCEL)

DRIFT_TOLERANCES = 2
"""So many tolerances off is still a camera in step whose drift is being corrected."""


class NotReadyQuestion(Question):
    """Says what keeps the cameras from being ready, as it is now."""

    def on_status_changed(self, message: StatusChanged) -> None:
        """Say it anew."""
        text = doubts_about(message.status) or "All cameras are ready now."
        self.query_one(".question", Static).update(Content(printable(text)))


def not_ready_question(status: RigStatus | None) -> Question | None:
    """Ask whether to `wait` until the rig is ready, or to `take` all the same; None where it is."""
    doubts = "" if status is None else doubts_about(status)
    return NotReadyQuestion(doubts, ANYWAY, title="Not ready") if doubts else None


def again_question(take: JudgedTake) -> Question:
    """Ask whether to `keep` the take before or to `trash` it."""
    verdict = take.verdict
    text = f"{take.sheet.session.name} is {verdict.headline}\nspread {verdict.spread}"
    return Question(text, AGAIN, title="Take again")


def doubts_about(status: RigStatus) -> str:
    """Say in sentences which cameras are not ready and what their pictures will be; empty: none."""
    cameras = cameras_of(status)
    unready = [node for node in cameras if node.state is not NodeState.READY and not _touches_up(node)]
    here = [node for node in unready if node.state is not NodeState.LOST]
    if not here:
        return ""
    ready = len(cameras) - len(unready)
    lines = [f"{ready} of {len(cameras)} cameras are ready."]
    lines += [_doubt(node, status.period_ns) for node in here[:6]]
    if len(here) > 6:
        lines.append(f"and {count(len(here) - 6, 'more camera')}")
    return "\n".join(lines)


def _touches_up(node: NodeStatus) -> bool:
    """Whether a camera in step is just correcting a drift: for a moment, which is no reason to ask."""
    error_ns = node.phase_error_ns
    aligning = node.state is NodeState.ALIGNING and error_ns is not None
    return aligning and abs(error_ns or 0) <= DRIFT_TOLERANCES * node.tolerance_ns


def _doubt(node: NodeStatus, period_ns: int | None) -> str:
    if node.state is NodeState.ALIGNING:
        most_ns = period_ns // 2 if period_ns else None
        error_ns = most_ns if node.phase_error_ns is None else abs(node.phase_error_ns)
        fate = (
            f"its pictures will be about {duration(error_ns)} off" if error_ns else "its pictures will be off"
        )
    elif node.state is NodeState.FAILED:
        fate = "it gives no pictures"
    else:
        fate = "its pictures will be missing or at an unsure time"
    reason = f" ({node.message})" if node.message else ""
    return f"{node.name} is {node.state}{reason}: {fate}."


WAIT_READY_S = 120.0
NARROW = 110
"""Below so many columns the plan leaves the pictures more room."""


class ShootView(BurstControl):
    """Takes pictures and shows what became of them."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("space", "take", "Take", id="shoot.take"),
        Binding("r", "retake", "Retake", id="shoot.retake", tooltip="the newest take once more"),
        Binding("v", "switch", "Live/sheet", id="shoot.switch", tooltip="live pictures or contact sheet"),
        Binding("w", "wiggle", "Wiggle", id="shoot.wiggle", tooltip="to and fro between cameras"),
        Binding("n", "edit('name')", "Name", id="shoot.name"),
        Binding("t", "edit('notes')", "Notes", id="shoot.note"),
        Binding("left_square_bracket", "frames(-1,0)", "Fewer before", id="shoot.before-less", show=False),
        Binding("right_square_bracket", "frames(1,0)", "More before", id="shoot.before-more", show=False),
        Binding("left_curly_bracket", "frames(0,-1)", "Fewer after", id="shoot.after-less", show=False),
        Binding("right_curly_bracket", "frames(0,1)", "More after", id="shoot.after-more", show=False),
        Binding("escape", "stop", "Stop, or back to live", id="shoot.stop", show=False),
    ]
    DEFAULT_CSS = """
    ShootView #shoot-side { width: 40; height: 1fr; }
    ShootView.narrow #shoot-side { width: 30; }
    ShootView.narrow.sheet #shoot-side { display: none; }
    """

    def __init__(self, rig: RigLink, settings: Settings, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock`: seconds."""
        super().__init__(id="shoot")
        self._rig, self._clock = rig, clock
        self._status: RigStatus | None = None
        self._log = TakeLog()
        self._waiting: Worker[None] | None = None  # an order for which the leader waits for the rig
        self._seen = False
        self.plan_panel = PlanPanel(settings)
        self.take_panel = TakePanel()
        self.stage = Stage(rig, clock)
        self._line = StatusLine()

    def compose(self) -> ComposeResult:
        """Plan and takes at the left, the pictures beside them."""
        with Horizontal():
            with Vertical(id="shoot-side"):
                yield self.plan_panel
                yield self.take_panel
            yield self.stage
        yield self._line

    @property
    def takes(self) -> tuple[Take, ...]:
        """The takes that the screen has heard of, the newest last."""
        return tuple(self._log.takes)

    def on_mount(self) -> None:
        """Show that there is no take yet, and from then on how long one takes."""
        self.take_panel.show(())
        self.set_interval(1.0, self._show_course)

    def on_resize(self) -> None:
        """Leave the pictures most of a small window."""
        self.set_class(self.size.width < NARROW, "narrow")
        self._show_course()
        self.call_after_refresh(self._want_previews)

    def on_mode_shown(self) -> None:
        """Look again."""
        self._seen = True
        super().on_mode_shown()
        self._want_previews()

    def on_mode_hidden(self) -> None:
        """No previews while nobody looks."""
        self._seen = False
        self._want_previews()

    def focus_first(self) -> None:
        """Arrows go over the sheet, or change the plan."""
        if not self.stage.focus_first():
            self.plan_panel.focus()

    def on_status_changed(self, message: StatusChanged) -> None:
        """Show the cameras, and takes that were ordered elsewhere."""
        status = self._status = message.status
        self.plan_panel.show_period(status.period_ns)
        self.stage.grid.show_status(status)
        if status.burst is not None:
            self._note(status.burst)
        self._show_course()
        self.call_after_refresh(self._want_previews)

    def on_preview_received(self, message: PreviewReceived) -> None:
        """Show what a camera sees."""
        self.stage.grid.show_preview(message.preview)

    def on_stage_changed(self) -> None:
        """Drive what is shown now."""
        self.set_class(self.stage.is_sheet, "sheet")
        self._show_course()
        if self._seen and self.screen.is_active:
            self.focus_first()
        self._want_previews()

    def action_take(self) -> None:
        """Take as planned; stop what counts down, goes on by itself or waits for the rig; end a recording."""
        if self._under_way:
            self.action_stop()
        elif not self.end_recording():
            self._begin(self.plan_panel.plan.request())

    def action_stop(self) -> None:
        """Stop a countdown, an interval, a sequence, a wait; what is taken already is saved."""
        if not self._under_way:
            self.stage.show_live()
        for worker in self._under_way:
            worker.cancel()

    def action_retake(self) -> None:
        """Take again as the last time, keeping or trashing what there is."""
        last = self._log.latest_ordered
        request = self.plan_panel.plan.request() if last is None or last.request is None else last.request
        if self._under_way:
            return
        if last is None or last.judged is None or last.trashed:
            self._begin(request)
            return

        def decide(answer: str | None) -> None:
            if answer == "trash":
                self._trash(last)
            if answer is not None:
                self._begin(request, retake_of=last.name)

        self.app.push_screen(again_question(last.judged), decide)

    def action_edit(self, what: str) -> None:
        """Type the name of the takes that follow, or notes for them."""
        self.plan_panel.edit(what)

    def action_frames(self, before: int, after: int) -> None:
        """Take more or fewer frames before the key, or after it."""
        plan = self.plan_panel.plan.with_before(self.plan_panel.plan.before + before)
        self.plan_panel.set_plan(plan.with_after(plan.after + after))

    def action_switch(self) -> None:
        """Switch between what the cameras see and the last take."""
        self.stage.switch()

    def action_wiggle(self) -> None:
        """Wiggle through the cameras at the chosen instant of the last take."""
        self.stage.wiggle()

    def _begin(self, request: BurstRequest, *, retake_of: str = "") -> None:
        """Take, but ask before a take that cannot be good."""
        question = not_ready_question(self._status)
        if self._status is None or question is None:
            self._shoot(request, retake_of)
            return
        waiting = replace(request, wait_ready_s=WAIT_READY_S, nodes=len(cameras_of(self._status)))

        def decide(answer: str | None) -> None:
            if answer == "wait":
                self._shoot(waiting, retake_of)
            elif answer == "take":
                self._shoot(request, retake_of)

        self.app.push_screen(question, decide)

    @property
    def _under_way(self) -> list[Worker[Any]]:
        """What a stop ends: a countdown, interval or sequence, and an order that waits for the rig."""
        ours = [worker for worker in self.workers if worker is self._waiting or worker.group == "shooting"]
        return [worker for worker in ours if not worker.is_finished]

    @work(exclusive=True, group="shooting")
    async def _shoot(self, request: BurstRequest, retake_of: str) -> None:
        def take() -> asyncio.Event:
            done = asyncio.Event()
            self._follow(request, retake_of, done)
            return done

        try:
            now = asyncio.get_running_loop().time
            await Shooting(take, self._show_moment, now=now).run(self.plan_panel.plan)
        finally:
            self._line.moment = ""
            self.stage.end_countdown()
            self._show_course()

    @work(group="bursts")
    async def _follow(self, request: BurstRequest, retake_of: str, done: asyncio.Event) -> None:
        """Follow a burst until it is saved, whatever becomes of the takes after it."""
        self._line.failure = ""
        try:
            async for status in self._rig.burst(request):
                if not status.name:
                    self._waiting, self._line.waiting = get_current_worker(), status.message or "ordered"
                    self._show_course()
                    continue
                self._end_wait()
                self._note(status, request, retake_of)
        except SimulshotError as error:
            self._line.failure = error.what
            self.post_message(Mishap(error))
        finally:
            self._end_wait()
            done.set()

    def _end_wait(self) -> None:
        if self._waiting is get_current_worker():
            self._waiting, self._line.waiting = None, ""
        self._show_course()

    def _show_moment(self, moment: Moment) -> None:
        self.stage.show_moment(moment)
        self._line.moment = str(moment)
        self._show_course()

    def _note(self, status: BurstStatus, request: BurstRequest | None = None, retake_of: str = "") -> None:
        """Take note of how far a burst is."""
        if status.name and (take := self._log.note(status, request, self._clock(), retake_of)) is not None:
            if status.done:
                self._judge(take)
            self._show_course()

    @work(group="judging")
    async def _judge(self, take: Take) -> None:
        try:
            take.judged = await asyncio.to_thread(judge_take, take.status)
        except SimulshotError as error:
            take.problem = describe_failure(error)
        shown = self._log.of_sheet(self.stage.sheet.sheet)
        if take.judged is not None and self._log.is_newer(take, shown):
            self.stage.load_sheet(take.judged.sheet, take.key_instant)
            if take.is_new and not self._under_way:
                self.stage.show_sheet()
        self._show_course()

    @work(group="trash")
    async def _trash(self, take: Take) -> None:
        assert take.judged is not None
        try:
            await asyncio.to_thread(trash_session, take.judged.sheet.session.folder)
        except SimulshotError as error:
            self.post_message(Mishap(error))
            return
        take.trashed = True
        self.stage.forget_sheet(take.judged.sheet)
        self._show_course()

    def _show_course(self) -> None:
        """Show what is under way, in the takes and in the line below."""
        now_s = self._clock()
        self.take_panel.show(self._log.takes, now_s)
        shown = self._log.of_sheet(self.stage.sheet.sheet)
        advice = "" if self._status is None else printable(self._status.advice)
        otherwise = Content.styled(advice, "$foreground-muted")
        if self.has_class("narrow", "sheet") and shown is not None:
            otherwise = verdict_line(shown)
        self._line.show_course(self._log.newest, now_s, otherwise)

    def _want_previews(self) -> None:
        self.stage.want_previews(self._seen)
