"""Mode Shoot: Space takes; live previews beside the plan, followed by the contact sheet of the take."""

import asyncio
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import aclosing
from pathlib import Path, PurePath
from typing import ClassVar

from msgspec.structs import replace
from textual import work
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.content import Content
from textual.worker import Worker

from capture_app.common.errors import SimulshotError
from capture_app.common.text import clock_offset, count, printable
from capture_app.protocol.orders import CancelBurst, EndBurst, Order
from capture_app.protocol.status import BurstStatus, Preview, RigStatus
from capture_app.rig.live_pictures import live_depth, live_people
from capture_app.rig.rig_link import LinkLost, RigLink
from capture_app.rig.taking import (
    Begun,
    Countdown,
    Failed,
    Moved,
    Progress,
    TakeEvent,
    TakePlan,
    Taking,
    Waiting,
)
from capture_app.session.format.live_pictures import DEPTH, PEOPLE, LivePicture
from capture_app.session.library.changes import trash_session
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.tui.jobs.result_screen import open_report
from capture_app.tui.jobs.runs import Runs
from capture_app.tui.mode import ModeView
from capture_app.tui.question import CANCEL, Answer, Question, explain_verdict
from capture_app.tui.rig_record import ActionFailed, RecordChanged, RigRecord, showing_errors
from capture_app.tui.screen_settings import Settings
from capture_app.tui.shoot import take_depth
from capture_app.tui.shoot.shoot_plan import PlanPanel
from capture_app.tui.shoot.stage import LIVE, Stage
from capture_app.tui.shoot.takes import (
    Take,
    TakePanel,
    open_take,
    progress_words,
    verdict_line,
)
from capture_app.tui.signs import NO_LEADER
from capture_app.tui.widgets.lines import Lines, write_border

MAX_ANSWERS = 9
"""Maximum bursts offered for cancellation, one per digit key."""
MAX_TAKES = 100
SOON_S = 5.0
"""Time in which live depth usually starts."""
FOUND = {DEPTH: "depth is starting", PEOPLE: "people are looked for"}
NARROW = 110
"""Columns below which a window is narrow; the plan then leaves more space to the pictures."""
AGAIN = (Answer("keep", "k", "Keep, take again"), Answer("trash", "t", "Trash, take again"), CANCEL)


class ShootView(ModeView):
    """View that takes pictures and shows the results."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("space", "take", "Take", id="shoot.take"),
        Binding("r", "retake", "Again", id="shoot.retake", tooltip="repeat the newest take"),
        Binding(
            "F",
            "edit('mode')",
            "Record",
            id="shoot.mode",
            tooltip="a video, a time lapse, or on motion",
        ),
        Binding("v", "switch", "Live/sheet", id="shoot.switch", tooltip="live pictures or contact sheet"),
        Binding("d", "open_depth", "Depth", id="shoot.depth", tooltip="the newest take in 3D in the browser"),
        Binding(
            "D",
            f"live('{DEPTH}')",
            "Live depth",
            id="shoot.live-depth",
            key_display="D",
            tooltip="of the chosen preview",
        ),
        Binding(
            "J",
            f"live('{PEOPLE}')",
            "Live people",
            id="shoot.live-people",
            key_display="J",
            show=False,
            tooltip="their joints in 3D, drawn into the chosen preview",
        ),
        Binding("y", "explain", "Why", id="shoot.why", tooltip="explains the verdict on the newest take"),
        Binding("n", "edit('name')", "Name", id="shoot.name"),
        Binding("t", "edit('notes')", "Note", id="shoot.note"),
        Binding("left_square_bracket", "frames(-1,0)", "Fewer before", id="shoot.before-less", show=False),
        Binding("right_square_bracket", "frames(1,0)", "More before", id="shoot.before-more", show=False),
        Binding("left_curly_bracket", "frames(0,-1)", "Fewer after", id="shoot.after-less", show=False),
        Binding("right_curly_bracket", "frames(0,1)", "More after", id="shoot.after-more", show=False),
        Binding("m", "mark", "Mark", id="shoot.mark", show=False, tooltip="an event in the take under way"),
        Binding("escape", "stop", "Stop, or back to live", id="shoot.stop", show=False),
        Binding(
            "x",
            "cancel_burst",
            "Cancel",
            id="shoot.cancel",
            show=False,
            tooltip="a take that is scheduled, or being saved",
        ),
    ]

    def __init__(
        self, rig: RigLink, record: RigRecord, settings: Settings, depth_runs: Runs | None = None
    ) -> None:
        """`depth_runs`: runs that compute each take's depth; None: no depth."""
        self._rig, self._record = rig, record
        self._depth_runs = depth_runs
        self.takes: list[Take] = []
        """Takes known to the screen, newest last."""
        self._taking = Taking(rig, TakePlan())
        """Newest takes ordered here; initially empty and never started."""
        self._course = ""
        """What these takes wait for, in words."""
        self._failure = ""
        """Reason why the last order failed; the next order ends it, and a leader that is back."""
        self._was_lost = self._could_stop = False
        self._requested = ""
        """What is shown in the chosen preview's place, DEPTH or PEOPLE; empty for the preview."""
        self._finder: Worker[None] | None = None
        """Worker that shows it."""
        self.plan_panel = PlanPanel(settings)
        self.take_panel = TakePanel()
        self.stage = Stage(rig, record)
        self._line = Lines(id="shoot-advice")
        super().__init__(
            Horizontal(Vertical(self.plan_panel, self.take_panel, id="shoot-side"), self.stage),
            self._line,
            id="shoot",
        )

    def on_mount(self) -> None:
        """Show the empty pane and start the updates of elapsed times."""
        self.take_panel.show(())
        self.watch(self.stage, "current", self._drive_stage, init=False)
        self.set_interval(1.0, self._show_course)

    def on_resize(self) -> None:
        """Leave most of a small window to the pictures."""
        self.set_class(self.size.width < NARROW, "narrow")
        self._show_course()
        self.call_after_refresh(self._want_previews)

    def on_mode_shown(self) -> None:
        """Focus, and request the previews again."""
        super().on_mode_shown()
        self._want_previews()

    def focus_first(self) -> None:
        """Focus the sheet or the plan, whichever the arrow keys should drive."""
        (self.stage.sheet if self.stage.is_sheet else self.plan_panel).focus()

    def on_record_changed(self, message: RecordChanged) -> None:
        """Show cameras, previews, and takes ordered elsewhere."""
        match message.what:
            case Preview() as preview:
                self.stage.show_preview(preview)
            case Runs():
                self._show_course()
                self.refresh_bindings()
            case LinkLost():
                self._was_lost = True
                self.stage.grid.show_lost()
                self._show_course()
            case RigStatus() as status:
                if self._was_lost:
                    self._was_lost, self._failure = False, ""
                self.plan_panel.show_rig(status)
                self.stage.grid.show_status(status)
                if status.burst is not None and status.burst.name:
                    self._note(status.burst)
                self._note_saved(status)
                self._show_course()
                self.call_after_refresh(self._want_previews)

    def _drive_stage(self) -> None:
        """Adapt layout, focus and previews to the stage's content."""
        self.set_class(self.stage.is_sheet, "sheet")
        self._show_course()
        if self.screen.is_active:
            self.focus_first()
        self._want_previews()

    def action_take(self) -> None:
        """Take as planned; take now if waiting for the rig; stop a series; stop a recording."""
        if self._taking.is_waiting:
            self._taking.take_now()
        elif self._taking.is_open:
            self.action_stop()
        elif (recording := self._recording) is not None:
            self._order(EndBurst(burst=recording.status.burst))
            recording.ended_s = self._record.clock()
            self._show_course()
        elif self.takes and (last := self.takes[-1]).has_ended_alone:
            last.has_ended_alone = False
            self.notify(
                f"{last.name} has ended by itself, after {last.length_s(self._record.clock()):.0f} s; "
                "Space again records the next one",
                markup=False,
            )
        else:
            self._shoot(self.plan_panel.plan())

    @property
    def _recording(self) -> Take | None:
        """The recording under way, which Space ends. It is known by its name: a new leader numbers anew."""
        newest = None if self._record.status is None else self._record.status.burst
        name = "" if newest is None else newest.name
        return next((take for take in self.takes if take.status.name == name and take.is_recording), None)

    def describe_key(self, action: str) -> str:
        """Name what the key of an action does now; empty for its usual name."""
        if action != "take":
            return ""
        return (
            "Stop"
            if self._recording is not None
            else "Record"
            if self.plan_panel.settings.mode == "recording"
            else ""
        )

    def action_stop(self) -> None:
        """Stop a countdown, a series or a wait; images already taken are saved."""
        if self._taking.is_open:
            self._taking.stop()
            self._end_course()
        else:
            self.stage.show_live()

    @work(group="asking")
    async def action_retake(self) -> None:
        """Repeat the last take, after asking whether to keep or trash it."""
        last = next((take for take in reversed(self.takes) if take.plan is not None), None)
        plan = (last and last.plan) or self.plan_panel.plan()
        if self._taking.is_open:
            return
        if last is None or last.sheet is None or last.trashed:
            self._shoot(plan)
            return
        verdict = last.sheet.verdict
        text = f"{last.sheet.session.name} is {verdict.headline}\nspread {verdict.spread}"
        answer = await self.app.push_screen_wait(Question(text, AGAIN, title="Take again"))
        if answer == "trash":
            self._trash(last, last.sheet)
        if answer is not None:
            self._shoot(plan, retake_of=last.name)

    @work(group="marking")
    async def action_mark(self) -> None:
        """Note an event now, in the session of the take under way."""
        with showing_errors(self):
            placed = await self._rig.mark("mark")
            self.notify(f"marked in {', '.join(placed.sessions) or placed.file}")

    def action_edit(self, what: str) -> None:
        """Edit the name or the notes of the following takes."""
        self.plan_panel.action_edit(what)

    def action_frames(self, before: int, after: int) -> None:
        """Change the number of frames before or after the key press."""
        settings = self.plan_panel.settings.with_before(self.plan_panel.settings.before + before)
        self.plan_panel.change(settings.with_after(settings.after + after))

    def action_switch(self) -> None:
        """Switch between the live previews and the last take."""
        (self.stage.show_live if self.stage.is_sheet else self.stage.show_sheet)()

    def action_live(self, subject: str) -> None:
        """Show depth, or people in 3D, in place of the chosen camera's preview; or its preview again."""
        if self._finder is not None:
            self._finder.cancel()
            self._finder = None
        self._requested = "" if self._requested == subject else subject
        self.stage.show_live()
        self._want_previews()

    @work(group="live-pictures", exclusive=True)
    async def _show_found(self, status: RigStatus, subject: str) -> None:
        begun_s = self._record.clock()

        def say_starting() -> None:
            """Say for how long: the process takes seconds to start, and more on a busy machine."""
            for_s = self._record.clock() - begun_s
            words = FOUND[subject] + (f", for {for_s:.0f} s: this machine is busy" if for_s > SOON_S else "")
            self.stage.show_found(LivePicture(0, self.stage.grid.chosen(), problem=words))

        say_starting()
        starting = self.set_interval(1.0, say_starting)
        find: Callable[..., AsyncGenerator[LivePicture, None]] = (
            live_depth if subject == DEPTH else live_people
        )
        try:
            with showing_errors(self):
                async with aclosing(find(self._rig.another(), status, self.stage.grid.chosen)) as found:
                    async for picture in found:
                        starting.stop()
                        self.stage.show_found(picture)
            self._requested = ""  # it ended by an error
        finally:
            starting.stop()
            self.stage.show_found(None)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer only actions available for the newest take."""
        return {
            "explain": self._newest_sheet is not None,
            # Looked for on the disk, and so for no other action.
            "open_depth": action == "open_depth" and self._depth_report() is not None,
        }.get(action, True)

    def action_explain(self) -> None:
        """Explain the verdict on the newest take."""
        if (sheet := self._newest_sheet) is not None:
            self.app.push_screen(explain_verdict(sheet))

    def action_open_depth(self) -> None:
        """Open the interactive 3D page of the newest take's depth."""
        open_report(self, self._depth_report())

    def _depth_report(self) -> Path | None:
        run = take_depth.run_of(self._depth_runs, self._newest_sheet)
        return None if run is None else run.report

    @work(group="asking")
    async def action_cancel_burst(self) -> None:
        """Ask which burst to cancel, and cancel it."""
        status = self._record.status
        offers = {} if status is None else cancellable_bursts(status, self.takes)
        if not offers:
            self.notify("no take is scheduled or being saved")
            return
        answers = [
            Answer(str(burst), str(key), words)
            for key, (burst, words) in enumerate(list(offers.items())[:MAX_ANSWERS], 1)
        ]
        answer = await self.app.push_screen_wait(
            Question(
                "Images saved so far stay; the others are dropped.",
                [*answers, Answer("", "esc", "Keep all")],
                title="Cancel a take",
            )
        )
        if answer is not None:
            self._order(CancelBurst(burst=int(answer)))

    @work(group="orders")
    async def _order(self, order: Order) -> None:
        with showing_errors(self):
            await self._rig.order(order)

    @work(group="shooting")
    async def _shoot(self, plan: TakePlan, *, retake_of: str = "") -> None:
        """Take once all settling cameras are ready, and show the progress until all is saved."""
        taking = self._taking = Taking(self._rig, plan.when_ready(self._record.status))
        self._failure = ""
        try:
            async for event in taking:
                self._show_event(event, plan, retake_of)
        finally:
            if self._taking is taking:
                self._end_course()

    def _show_event(self, event: TakeEvent, plan: TakePlan, retake_of: str) -> None:
        of = f"take {event.number} of {plan.repeat}" if plan.repeat > 1 else "the take"
        match event:
            case Countdown(seconds=seconds):
                self._course = f"◉ {of} in {seconds} s"
                self.stage.count_down(seconds, f"{of} in {seconds} s")
            case Moved(camera=camera):
                self.notify(f"something moves in front of {self._record.title(camera)}", markup=False)
            case Waiting(reason=reason):
                keys = "◔ Space takes now, esc cancels; " if self._taking.is_waiting else f"◉ {of}: "
                self._end_course(keys + reason)
            case Begun():
                self._end_course(f"◉ {of} is being taken")
                if plan.video:  # not the sheet of the take before
                    self.stage.show_live()
            case Progress(status=status):
                self._course = self._course if self._taking.is_open else ""
                self._note(status, plan, retake_of)
            case Failed(error=error, status=status) if status is None or not status.done:
                self._end_course()
                self._failure = error.what
                self.post_message(ActionFailed(error))
                for take in self.takes:
                    if status is not None and take.status.name == status.name:
                        take.problem = error.what
        self._show_course()

    def _end_course(self, course: str = "") -> None:
        """End the countdown, and show `course` as the current state."""
        self._course = course
        self.stage.end_countdown()
        self._show_course()

    def _note(self, status: BurstStatus, plan: TakePlan | None = None, retake_of: str = "") -> None:
        """Store a burst's progress.

        Each burst is reported twice: in the reply to the request, which also gives its plan, and in the rig's
        status.
        """
        take = next((take for take in self.takes if take.status.name == status.name), None)
        was_done = take is not None and take.status.done
        if take is None:
            take = Take(status, is_new=not status.done or plan is not None, begun_s=self._record.clock())
            self.takes = [*self.takes, take][-MAX_TAKES:]
        take.plan, take.retake_of = plan or take.plan, retake_of or take.retake_of
        # A saved take that is not done is open again: its missing images arrive.
        if not was_done or (status.session is not None and not status.done):
            take.status, take.problem = status, ""
            if status.ended and take.ended_s is None:
                take.ended_s = self._record.clock()
                # Space is then meant for it, unless its length was chosen.
                take.has_ended_alone = (
                    status.recording
                    and take.plan is not None
                    and take.plan.seconds != self.plan_panel.settings.seconds
                )
            take.note_saved(self._record.clock())
            if status.done:
                self._judge(take)

    def _note_saved(self, status: RigStatus) -> None:
        """Store the end of takes that a newer one replaced in the rig's status before they were done."""
        sessions = {PurePath(path).name: path for path in status.sessions}
        newest = "" if status.burst is None else status.burst.name
        for take in self.takes:
            session = sessions.get(take.status.name)
            if session is not None and not take.status.done and take.status.name != newest:
                self._note(replace(take.status, done=True, session=session, message=""))

    @work(group="judging")
    async def _judge(self, take: Take) -> None:
        try:
            take.sheet = await asyncio.to_thread(open_take, take.status)
        except SimulshotError as error:
            take.problem = f"the take cannot be shown: {error}"
        shown = self._shown
        if take.sheet is not None and (shown is None or self.takes.index(take) > self.takes.index(shown)):
            # Start at the instant of the key press, which the photographer meant.
            self.stage.load_sheet(take.sheet, 0 if take.plan is None else take.plan.before)
            if take.is_new and not self._taking.is_open:
                self.stage.show_sheet()
        if take.sheet is not None and take.is_new:
            await take_depth.begin(self._depth_runs, take.sheet)
        self._show_course()
        if self.is_attached:  # the screen may have been closed meanwhile
            self.refresh_bindings()

    @property
    def _newest_sheet(self) -> TakeSheet | None:
        newest = next(reversed(self.takes), None)
        return None if newest is None or newest.trashed else newest.sheet

    @property
    def _shown(self) -> Take | None:
        """The take whose sheet is loaded."""
        return next((take for take in self.takes if take.sheet is self.stage.sheet.sheet is not None), None)

    @work(group="trash")
    async def _trash(self, take: Take, sheet: TakeSheet) -> None:
        with showing_errors(self):
            await asyncio.to_thread(trash_session, sheet.session.folder)
            take.trashed = True
            self.stage.forget_sheet(sheet)
            self._show_course()

    @work(group="judging")
    async def follow_session(self, before: Path, after: Path | None) -> None:
        """Show a take as its session is now: renamed, in the trash (None), or restored; absolute paths."""
        for take in self.takes:
            if (old := take.sheet) is None or old.session.folder != before:
                continue
            take.trashed = after is None
            if after is None:
                self.stage.forget_sheet(old)
            elif after != before:
                with showing_errors(self):
                    take.sheet = await asyncio.to_thread(TakeSheet.open, after)
                    if self.stage.sheet.sheet is old:
                        self.stage.load_sheet(take.sheet, 0)
        self._show_course()

    def _show_course(self) -> None:
        """Show the current activity in the takes pane and in the line below, and of when the previews are."""
        self.stage.show_ages()
        now_s, of_newest = self._record.clock(), (self._depth_runs, self._newest_sheet)
        depth = list(take_depth.lines(*of_newest))
        self.take_panel.show(self.takes, now_s, depth, take_depth.picture(*of_newest))
        # The sheet hides that pane in a narrow window.
        write_border(
            self.stage, None, depth[0] if depth and self.has_class("narrow", "sheet") else Content("")
        )
        self._line.show(self._words(now_s).wrap(max(self._line.size.width, 1)))
        if self._could_stop != (can_stop := self._recording is not None):
            self._could_stop = can_stop
            self.refresh_bindings()

    def _words(self, now_s: float) -> Content:
        """Return the line's text: the pending activity, a failure, the verdict, or the rig's advice."""
        newest = next(reversed(self.takes), None)
        if self._course:
            return Content.styled(printable(self._course), "bold $primary")
        if self._record.lost:
            remedy = " (l restarts it)" if self.app.check_action("start", ()) else ""
            return Content.styled(printable(f"{NO_LEADER}{remedy}: {self._record.lost}"), NO_LEADER.style)
        if newest is not None and not newest.status.done and not newest.problem:
            words = f"◔ {printable(newest.status.name)}: {progress_words(newest, now_s, self.takes)}"
            words += "; Space stops, x cancels" if newest is self._recording else "; x cancels"
            return Content.styled(words, "bold $primary")
        if self._failure:
            return Content.styled(f"! no take: {printable(self._failure)}", "bold $warning")
        if self.has_class("narrow", "sheet") and self.stage.sheet.sheet is not None:
            return verdict_line(self.stage.sheet.sheet.verdict)
        advice = self.plan_panel.advice or ("" if self._record.status is None else self._record.status.advice)
        return Content.styled(printable(advice), "$foreground-muted")

    def _want_previews(self) -> None:
        if not self.is_attached:  # a take may end while the screen closes
            return
        self.stage.want_previews(self.screen.is_active)
        requested = self._requested if self.screen.is_active and self.stage.current == LIVE else ""
        if self._finder is not None and not requested:
            self._finder.cancel()
        elif requested and self._record.status and (self._finder is None or self._finder.is_finished):
            self._finder = self._show_found(self._record.status, requested)

    on_mode_hidden = _want_previews


def cancellable_bursts(status: RigStatus, takes: Sequence[Take]) -> dict[int, str]:
    """Return the cancellable bursts in words, by number: those being saved, then the scheduled ones.

    Of those being saved, the status has the newest; the progress of earlier `takes` is followed here if they
    were ordered here.
    """
    followed = [take.status for take in takes if take.plan is not None and not take.problem]
    saving = {
        of.burst: f"{of.name}: {of.received} of {of.expected} images received"
        for of in (*followed, *filter(None, [status.burst]))
        if of.burst and not of.done
    }
    scheduled = {
        of.burst: f"{of.name}: begins in "
        f"{clock_offset(max(0, of.first_leader_ns - status.now_ns), signed=False)}"
        f", {count(of.instants, 'frame')}"
        for of in sorted(status.ahead, key=lambda of: of.first_leader_ns)
    }
    return saving | scheduled
