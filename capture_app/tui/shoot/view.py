"""The mode Shoot: Space takes; what the cameras see beside the plan, then at once the contact sheet."""

import asyncio
from contextlib import aclosing
from typing import Any, ClassVar

from msgspec.structs import replace
from textual import work
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.content import Content
from textual.worker import Worker, get_current_worker

from capture_app.common.errors import SimulshotError
from capture_app.common.node_state import NodeState
from capture_app.common.text import clock_offset, count, duration, printable
from capture_app.protocol.messages import BurstRequest
from capture_app.protocol.orders import CancelBurst, EndBurst, Order
from capture_app.protocol.status import BurstStatus, NodeStatus, Preview, RigStatus
from capture_app.rig.link import RigLink
from capture_app.rig.motion import MotionWatch, watch_motion
from capture_app.session.library.trash import trash_session
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.tui.jobs.result_screen import open_report
from capture_app.tui.jobs.runs import Runs
from capture_app.tui.mode import ModeView
from capture_app.tui.question import CANCEL, Answer, Question
from capture_app.tui.rig_record import Mishap, RigRecord, Told, telling
from capture_app.tui.settings import Settings
from capture_app.tui.shoot import take_depth
from capture_app.tui.shoot.plan import REGIONS, PlanPanel, moments_of
from capture_app.tui.shoot.stage import Stage
from capture_app.tui.shoot.takes import Take, TakePanel, open_take, progress_words, verdict_line
from capture_app.tui.signs import cameras_of, is_settled
from capture_app.tui.widgets.lines import Lines

MOST_ANSWERS = 9
"""How many bursts are offered to be cancelled: as many as there are keys for."""
WAIT_READY_S = 120.0
MOST_TAKES = 100
NARROW = 110
"""A window of fewer columns is narrow: the plan leaves the pictures more room."""


class ShootView(ModeView):
    """Takes pictures and shows what became of them."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("space", "take", "Take", id="shoot.take"),
        Binding("r", "retake", "Retake", id="shoot.retake", tooltip="the newest take once more"),
        Binding("v", "switch", "Live/sheet", id="shoot.switch", tooltip="live pictures or contact sheet"),
        Binding("w", "wiggle", "Wiggle", id="shoot.wiggle", tooltip="to and fro between cameras"),
        Binding(
            "d", "turn", "Turn it", id="shoot.turn", show=False, tooltip="the last take's depth, by hand"
        ),
        Binding("n", "edit('name')", "Name", id="shoot.name"),
        Binding("t", "edit('notes')", "Notes", id="shoot.note"),
        Binding("left_square_bracket", "frames(-1,0)", "Fewer before", id="shoot.before-less", show=False),
        Binding("right_square_bracket", "frames(1,0)", "More before", id="shoot.before-more", show=False),
        Binding("left_curly_bracket", "frames(0,-1)", "Fewer after", id="shoot.after-less", show=False),
        Binding("right_curly_bracket", "frames(0,1)", "More after", id="shoot.after-more", show=False),
        Binding("escape", "stop", "Stop, or back to live", id="shoot.stop", show=False),
        Binding(
            "x",
            "cancel_burst",
            "Cancel a burst",
            id="shoot.cancel",
            show=False,
            tooltip="ahead, or being saved",
        ),
    ]

    def __init__(
        self, rig: RigLink, record: RigRecord, settings: Settings, depth_runs: Runs | None = None
    ) -> None:
        """`depth_runs`: what makes the depth of each take; None: nothing does."""
        self._rig, self._record = rig, record
        self._depth_runs = depth_runs
        self.takes: list[Take] = []
        """The takes that the screen has heard of, the newest last."""
        self._waiting: Worker[None] | None = None
        """An order for which the leader waits for the rig."""
        self._wait = ""
        """What keeps that order from being a take."""
        self._moment = ""
        """The countdown, or the take that is just ordered."""
        self._failure = ""
        """Why the last order came to nothing."""
        self.plan_panel = PlanPanel(settings)
        self.take_panel = TakePanel()
        self.stage = Stage(rig, record)
        self._line = Lines(id="shoot-advice")
        side = Vertical(self.plan_panel, self.take_panel, id="shoot-side")
        super().__init__(Horizontal(side, self.stage), self._line, id="shoot")

    def on_mount(self) -> None:
        """Show that there is no take yet, and from then on how long one takes."""
        self.take_panel.show(())
        self.watch(self.stage, "current", self._drive_stage, init=False)
        self.set_interval(1.0, self._show_course)

    def on_resize(self) -> None:
        """Leave the pictures most of a small window."""
        self.set_class(self.size.width < NARROW, "narrow")
        self._show_course()
        self.call_after_refresh(self._want_previews)

    def on_mode_shown(self) -> None:
        """Look again."""
        super().on_mode_shown()
        self._want_previews()

    def focus_first(self) -> None:
        """Arrows go over the sheet, or change the plan."""
        (self.stage.sheet if self.stage.is_sheet else self.plan_panel).focus()

    def on_told(self, message: Told) -> None:
        """Show the cameras, what they see, and takes that were ordered elsewhere."""
        match message.what:
            case Preview() as preview:
                self.stage.grid.show_preview(preview)
            case Runs():
                self._show_course()
            case RigStatus() as status:
                self.plan_panel.show_period(status.period_ns)
                self.stage.grid.show_status(status)
                if status.burst is not None and status.burst.name:
                    self._note(status.burst)
                self._show_course()
                self.call_after_refresh(self._want_previews)

    def _drive_stage(self) -> None:
        """Drive what the stage shows now."""
        self.set_class(self.stage.is_sheet, "sheet")
        self._show_course()
        if self.screen.is_active:
            self.focus_first()
        self._want_previews()

    def action_take(self) -> None:
        """Take as planned; stop what counts down, goes on by itself or waits for the rig; end a recording."""
        newest = None if self._record.status is None else self._record.status.burst
        if self._under_way:
            self.action_stop()
        elif newest is not None and newest.recording and not newest.done:
            self._order(EndBurst(burst=newest.burst))
        else:
            self._begin(self.plan_panel.plan.request())

    def action_stop(self) -> None:
        """Stop a countdown, an interval, a sequence, a wait; what is taken already is saved."""
        if not self._under_way:
            self.stage.show_live()
        for worker in self._under_way:
            worker.cancel()

    @work(group="asking")
    async def action_retake(self) -> None:
        """Take again as the last time, keeping or trashing what there is."""
        last = next((take for take in reversed(self.takes) if take.request is not None), None)
        request = (last and last.request) or self.plan_panel.plan.request()
        if self._under_way:
            return
        if last is None or last.sheet is None or last.trashed:
            self._begin(request)
            return
        verdict = last.sheet.verdict
        text = f"{last.sheet.session.name} is {verdict.headline}\nspread {verdict.spread}"
        answer = await self.app.push_screen_wait(Question(text, AGAIN, title="Take again"))
        if answer == "trash":
            self._trash(last, last.sheet)
        if answer is not None:
            self._begin(request, retake_of=last.name)

    def action_edit(self, what: str) -> None:
        """Type the name of the takes that follow, or notes for them."""
        self.plan_panel.action_edit(what)

    def action_frames(self, before: int, after: int) -> None:
        """Take more or fewer frames before the key, or after it."""
        plan = self.plan_panel.plan.with_before(self.plan_panel.plan.before + before)
        self.plan_panel.set_plan(plan.with_after(plan.after + after))

    def action_switch(self) -> None:
        """Switch between what the cameras see and the last take."""
        (self.stage.show_live if self.stage.is_sheet else self.stage.show_sheet)()

    def action_wiggle(self) -> None:
        """Wiggle through the cameras at the chosen instant of the last take."""
        self.stage.sheet.action_look("wiggle")

    def action_turn(self) -> None:
        """Open the page on which the depth of the newest take is turned by hand."""
        run = take_depth.run_of(self._depth_runs, self._newest_sheet)
        if run is None or run.report is None:
            self.notify("the newest take has no depth")
        else:
            open_report(self, run.report)

    @work(group="asking")
    async def action_cancel_burst(self) -> None:
        """Ask which burst to cancel, and cancel it."""
        offers = {} if self._record.status is None else cancellable_bursts(self._record.status)
        if not offers:
            self.notify("no burst lies ahead, and none is being saved")
            return
        answers = [
            Answer(str(burst), str(key), words)
            for key, (burst, words) in enumerate(list(offers.items())[:MOST_ANSWERS], 1)
        ]
        question = Question(
            "What has come of it already is saved.", [*answers, CANCEL], title="Cancel a burst"
        )
        answer = await self.app.push_screen_wait(question)
        if answer is not None:
            self._order(CancelBurst(burst=int(answer)))

    @work(group="orders")
    async def _order(self, order: Order) -> None:
        with telling(self):
            await self._rig.order(order)

    @work(group="asking")
    async def _begin(self, request: BurstRequest, *, retake_of: str = "") -> None:
        """Take, but ask before a take that cannot be good."""
        status = self._record.status
        if status is not None and doubts_about(status):
            answer = await self.app.push_screen_wait(Question(self._doubts, ANYWAY, title="Not ready"))
            if answer is None:
                return
            if answer == "wait":
                request = replace(request, wait_ready_s=WAIT_READY_S, nodes=len(cameras_of(status)))
        self._shoot(request, retake_of)

    def _doubts(self) -> str:
        """What keeps the cameras from being ready, as it is now."""
        status = self._record.status
        return ("" if status is None else doubts_about(status)) or "All cameras are ready now."

    @property
    def _under_way(self) -> list[Worker[Any]]:
        """What a stop ends: a countdown, interval or sequence, and an order that waits for the rig."""
        ours = [worker for worker in self.workers if worker is self._waiting or worker.group == "shooting"]
        return [worker for worker in ours if not worker.is_finished]

    @work(exclusive=True, group="shooting")
    async def _shoot(self, request: BurstRequest, retake_of: str) -> None:
        saved, plan = asyncio.Event(), self.plan_panel.plan
        try:
            async for moment in moments_of(plan, saved):
                self.stage.show_moment(moment)
                self._moment = str(moment)
                self._show_course()
                if moment.watches and not moment.seconds:
                    at_ns = await self._motion_ns(MotionWatch(REGIONS[plan.region]))
                    self._moment = ""
                    self._follow(replace(request, at_leader_ns=at_ns), retake_of, saved)
                elif not moment.seconds:
                    self._follow(request, retake_of, saved)
        finally:
            self._moment = ""
            self.stage.show_moment(None)
            self._show_course()

    async def _motion_ns(self, watch: MotionWatch) -> int | None:
        """When something moves next, in leader time; on a link of its own, whose pictures are small."""
        async with aclosing(watch_motion(RigLink(self._rig.leader), watch)) as moving:
            async for seen in moving:
                self.notify(f"something moves before {printable(seen.camera)}", markup=False)
                return seen.leader_ns
        return None

    @work(group="bursts")
    async def _follow(self, request: BurstRequest, retake_of: str, saved: asyncio.Event) -> None:
        """Follow a burst until it is saved, whatever becomes of the takes after it."""
        self._failure = ""
        try:
            async for status in self._rig.burst(request):
                if status.name:
                    self._end_wait()
                    self._note(status, request, retake_of)
                else:
                    self._waiting, self._wait = get_current_worker(), status.message or "ordered"
                    self._show_course()
        except SimulshotError as error:
            self._failure = error.what
            self.post_message(Mishap(error))
        finally:
            self._end_wait()
            saved.set()

    def _end_wait(self) -> None:
        if self._waiting is get_current_worker():
            self._waiting = None
        self._show_course()

    def _note(self, status: BurstStatus, request: BurstRequest | None = None, retake_of: str = "") -> None:
        """Take note of how far a burst is.

        It is told twice: by the answer to the request, which is known then, and by the rig's status.
        """
        take = next((take for take in self.takes if take.name == status.name), None)
        was_done = take is not None and take.status.done
        if take is None:
            is_new = not status.done or request is not None
            take = Take(status, is_new=is_new, begun_s=self._record.clock())
            self.takes = [*self.takes, take][-MOST_TAKES:]
        take.request, take.retake_of = request or take.request, retake_of or take.retake_of
        if not was_done:
            take.status = status
            if status.done:
                self._judge(take)
        self._show_course()

    @work(group="judging")
    async def _judge(self, take: Take) -> None:
        try:
            take.sheet = await asyncio.to_thread(open_take, take.status)
        except SimulshotError as error:
            take.problem = f"it cannot be looked at: {error}"
        shown = self._shown
        newer = shown is None or self.takes.index(take) > self.takes.index(shown)
        if take.sheet is not None and newer:
            # The instant of the key is what the photographer meant.
            self.stage.load_sheet(take.sheet, 0 if take.request is None else take.request.before)
            if take.is_new and not self._under_way:
                self.stage.show_sheet()
        if take.sheet is not None and take.is_new:
            await take_depth.begin(self._depth_runs, take.sheet)
        self._show_course()

    @property
    def _newest_sheet(self) -> TakeSheet | None:
        newest = next(reversed(self.takes), None)
        return None if newest is None or newest.trashed else newest.sheet

    @property
    def _shown(self) -> Take | None:
        """The take whose sheet is at hand."""
        sheet = self.stage.sheet.sheet
        return next((take for take in self.takes if take.sheet is sheet is not None), None)

    @work(group="trash")
    async def _trash(self, take: Take, sheet: TakeSheet) -> None:
        with telling(self):
            await asyncio.to_thread(trash_session, sheet.session.folder)
            take.trashed = True
            self.stage.forget_sheet(sheet)
            self._show_course()

    def _show_course(self) -> None:
        """Show what is under way, in the takes and in the line below."""
        now_s = self._record.clock()
        sheet = self._newest_sheet
        runs = self._depth_runs
        self.take_panel.show(
            self.takes, now_s, take_depth.lines(runs, sheet), take_depth.picture(runs, sheet)
        )
        line = self._course(now_s).truncate(max(self._line.size.width, 1), ellipsis=True)
        self._line.show([line])

    def _course(self, now_s: float) -> Content:
        """What the user waits for, until it is there or has failed; else how good things are."""
        newest = next(reversed(self.takes), None)
        if self._waiting is not None:
            return Content.styled(f"◔ esc cancels; {printable(self._wait)}", "bold $primary")
        if self._moment:
            return Content.styled(f"◉ {printable(self._moment)}", "bold $primary")
        if newest is not None and not newest.status.done:
            far = progress_words(newest.status, now_s - newest.begun_s)
            return Content.styled(f"◔ {printable(newest.name)}: {far}", "bold $primary")
        if self._failure:
            return Content.styled(f"! no take: {printable(self._failure)}", "bold $warning")
        if self.has_class("narrow", "sheet") and self.stage.sheet.sheet is not None:
            return verdict_line(self.stage.sheet.sheet.verdict)
        advice = "" if self._record.status is None else self._record.status.advice
        return Content.styled(printable(advice), "$foreground-muted")

    def _want_previews(self) -> None:
        self.stage.want_previews(self.screen.is_active)

    on_mode_hidden = _want_previews


ANYWAY = (Answer("wait", "w", "Wait, then take"), Answer("take", "t", "Take now"), CANCEL)
AGAIN = (Answer("keep", "k", "Keep, take again"), Answer("trash", "t", "Trash, take again"), CANCEL)


def doubts_about(status: RigStatus) -> str:
    """Say in sentences which cameras are not ready and what their pictures will be; empty: none."""
    cameras = cameras_of(status)
    # Just correcting a drift, for a moment, is no reason to ask.
    in_step = [node for node in cameras if is_settled(node) and node.phase_error_ns is not None]
    unready = [node for node in cameras if node.state is not NodeState.READY and node not in in_step]
    here = [node for node in unready if node.state is not NodeState.LOST]
    if not here:
        return ""
    ready = len(cameras) - len(unready)
    lines = [f"{ready} of {len(cameras)} cameras are ready."]
    lines += [_doubt(node, status.period_ns) for node in here[:6]]
    if len(here) > 6:
        lines.append(f"and {count(len(here) - 6, 'more camera')}")
    return "\n".join(lines)


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


def cancellable_bursts(status: RigStatus) -> dict[int, str]:
    """The bursts that can be cancelled, by number, in words: the one being saved, then those ahead."""
    offers = {}
    newest = status.burst
    if newest is not None and newest.burst and not newest.done:
        offers[newest.burst] = f"{newest.name}: {newest.received} of {newest.expected} images are here"
    for burst in sorted(status.ahead, key=lambda burst: burst.first_leader_ns):
        begins = clock_offset(max(0, burst.first_leader_ns - status.now_ns), signed=False)
        offers[burst.burst] = f"{burst.name}: begins in {begins}, {count(burst.instants, 'frame')}"
    return offers
