"""Bursts of a leader: requested, ordered, collected and saved, including resumed ones of earlier runs."""

import asyncio
import dataclasses
import functools
import os
import time
from bisect import bisect_right
from collections import Counter, deque
from collections.abc import AsyncGenerator, Mapping
from pathlib import Path

from msgspec.structs import replace

from capture_app.common.errors import (
    BadInputError,
    DiskError,
    DiskFullError,
    IncompleteError,
    SimulshotError,
    UnwantedImageError,
)
from capture_app.common.names import check_name
from capture_app.common.node_state import WITHOUT_CAMERA, NodeState
from capture_app.common.take_limits import check_before
from capture_app.common.tasks import Background, end, has_come
from capture_app.common.timeouts import FORGET_LOST_NS
from capture_app.net.udp import Pump
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.burst.intake import disk_threads
from capture_app.node.burst.resumed_bursts import ResumedBursts
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.node.leader.readiness import (
    check_room,
    degraded_nodes,
    drift_apart,
    reasons_until_ready,
)
from capture_app.protocol.messages import BurstRequest, CameraReport, ReportAck, SpoolSpace
from capture_app.protocol.orders import MarkPlaced
from capture_app.protocol.status import BurstStatus
from capture_app.session.files.disk import free_bytes
from capture_app.session.format.manifest import AbsentCamera
from capture_app.session.format.marks import RIG_MARKS, Mark, check_mark_text
from capture_app.session.writing.rig_marks import append_mark
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.rig.events import TriggerAnswered
from capture_app.sync.rig.frame_selection import MAX_STREAMED_FRAMES, MAX_STREAMED_NS, Burst
from capture_app.sync.rig.leader_engine import Leader
from capture_app.sync.rig.roster import LEFT

LONG_NS = 2_000_000_000
END_LEAD_NS = 300_000_000
NEAR = 0.02
"""Maximum relative deviation from the requested rate."""
UNNAMED, RECORDING = "burst", "recording"
"""Prefixes of session names for takes without a name."""
MAX_FOLDER_NUMBER = 999_999
REMEMBERED = 64
SOON_NS = 30_000_000_000
"""Bursts that begin later than this count as ahead, and not among those being saved."""
SURE_FRAMES = 300
"""A recording needs room for at least this many frames of each camera before it begins."""
UNKNOWN_LENGTH_NS = 60_000_000_000
"""For a recording without an end, the cameras' drift within this time is reported."""
SILENCE_CHECK_S = 0.25
LOOK_EVERY_NS, LOOK_TIMEOUT_S = 2_000_000_000, 0.5
"""Interval between looks at the disk for a status, and how long a status waits for one."""
SNAPSHOT_EVERY_S = 0.25
MAX_OPEN_BURSTS, MAX_BURSTS_AHEAD = 16, 16
REPORT_INTERVAL_NS = 1_000_000_000
MIN_SPARE = 4
"""Minimum number of spare instants by default, and else as many as frames, for a loss of every other one."""


def order_of(request: BurstRequest, asked_ns: int, period_ns: int) -> BurstOrder:
    """Return the order of a burst requested at `asked_ns` of leader time, on a rig of that frame period.

    Frames of long bursts and of videos are sent as they are captured. Raises BadInputError for an interval
    that is not a whole number of periods.
    """
    spacing = request.spacing
    if request.interval_s is not None:
        periods = request.interval_s * 1e9 / period_ns
        spacing = max(1, round(periods))
        if abs(spacing - periods) > NEAR * periods:
            fps = 1e9 / period_ns
            raise BadInputError(
                f"{1 / request.interval_s:.4g} frames a second do not divide the rig's {fps:.4g} evenly",
                hint=f"use one of: {', '.join(f'{fps / n:.4g}' for n in (1, 2, 3, 4, 5))} ...",
            )
    step_ns = spacing * period_ns
    frames = request.frames or min(MAX_STREAMED_FRAMES, MAX_STREAMED_NS // step_ns)
    if request.frames is None and request.seconds is not None:
        frames = max(1, round(request.seconds * 1e9 / step_ns))
    at_ns = request.at_leader_ns
    if request.before:
        at_ns = (asked_ns if at_ns is None else at_ns) - request.before * step_ns
    return BurstOrder(
        frames=frames,
        spacing=spacing,
        spare=max(MIN_SPARE, frames) if request.spare is None else request.spare,
        at_leader_ns=at_ns,
        streamed=request.video or (not request.spare and (frames - 1) * step_ns > LONG_NS),
        video=request.video,
    )


def frames_until(burst: Burst, now_ns: int) -> int:
    """Return the frames of a burst that ends now, allowing time for every node to learn of the end."""
    return max(1, bisect_right(burst.instants_ns, now_ns + END_LEAD_NS))


def create_numbered(root: Path, prefix: str = UNNAMED, *, after: int = 0) -> tuple[SessionWriter, int]:
    """Create the session `PREFIX-NNN` with the next free number above `after`, and return that number too.

    Raises BadInputError, DiskFullError.
    """
    number = 1 + max([after, *(_number(path, prefix) for path in root.glob(f"{prefix}-*"))])
    while True:
        name = f"{prefix}-{number:03d}"
        try:
            return SessionWriter.create(root, name), number
        except BadInputError:
            if not (root / name).exists():
                raise
        number += 1


def _number(path: Path, prefix: str) -> int:
    digits = path.name.removeprefix(f"{prefix}-")
    return int(digits) if digits.isdecimal() and len(digits) <= len(str(MAX_FOLDER_NUMBER)) else 0


class ActiveBursts:
    """Bursts in progress: orders them from an engine, and collects each into a session."""

    def __init__(self, options: LeaderOptions, engine: Leader, pump: Pump) -> None:
        self._options, self._engine = options, engine
        self._pump, self._event_log = pump, options.log
        self.saved: deque[str] = deque(maxlen=REMEMBERED)
        """Paths of this run's newest sessions, newest last, which every status includes."""
        self.newest: BurstSession | None = None
        self._disk = disk_threads()
        self.resumed = ResumedBursts(options.sessions, self._take_up, self._disk, engine.config.instance)
        """Sessions of earlier runs, or finished ones of this run, that are being completed."""
        self._bursts: dict[int, BurstSession] = {}
        self._cancelled: set[int] = set()
        self._frames_of_ended: dict[int, int] = {}
        """Instants of the bursts that ended earlier than ordered, by number."""
        self._last_number = 0
        self._last_folders: dict[str, int] = {}
        """Number of the newest session, by name prefix."""
        self._image_bytes: dict[str, int] = {}
        self.spools: dict[str, SpoolSpace] = {}
        """Free space of each node, as last reported."""
        self._reported_ns = self.now_ns() - REPORT_INTERVAL_NS
        self._awaited_until_ns = self.now_ns() + FORGET_LOST_NS
        self._silent: set[str] = set()
        """Cameras of this run that silently left their last burst: one camera must not delay all others."""
        self.free_bytes: int | None = None
        """Free space of the sessions' disk, as last read; None while it does not answer."""
        self._looked_ns = self.now_ns() - LOOK_EVERY_NS
        self._looking: asyncio.Task[None] | None = None
        self._trouble = ""
        """Why the leader's disk currently accepts nothing, as last reported."""
        self._background = Background()
        self._background.start(self._watch_silence())
        self._background.start(
            self.resumed.resume_all(self.now_ns(), folders=options.resume, wait_ns=options.return_ns)
        )

    def now_ns(self) -> int:
        """Return the leader's time."""
        return self._options.clock.now_ns()

    def end_all(self) -> None:
        """Order the cameras of all recordings and long bursts to end now."""
        for session in self._bursts.values():
            if session.burst.streamed and not session.finished.is_set():
                self._stop_cameras(session)

    async def close(self) -> None:
        """Save bursts in progress with the images received so far."""
        await self._background.end()
        if self._looking is not None:
            await end(self._looking)
        for burst in tuple(self._bursts.values()):
            if not burst.finished.is_set():
                # Nodes still have the other images, and the next run may fetch them.
                await (burst.suspend() if burst.is_empty() else burst.break_off("the leader was stopped"))
                self._note_finished(burst)
        await self.resumed.suspend_all()
        self._disk.shutdown(wait=False)

    async def take(self, request: BurstRequest) -> AsyncGenerator[BurstStatus, None]:
        """Wait for the nodes as requested, take a burst, and yield its progress until it is done.

        Raises IncompleteError where the nodes are not ready in time, and the errors of `order`.
        """
        frames, asked_ns, engine = request.frames or 0, self.now_ns(), self._engine
        check_before(request.before, request.frames)
        before = BurstStatus(burst=0, name="", cameras=0, instants=frames, received=0, expected=0)
        if request.wait_ready_s:
            async for reason in reasons_until_ready(engine, request.wait_ready_s, request.nodes):
                yield replace(before, message=f"waiting for the rig: {reason}")
            asked_ns = self.now_ns()
        if degraded := degraded_nodes(engine.roster.by_name()):
            yield replace(before, message=f"less accurate than requested: {degraded}")
        grid = engine.grid
        # Without a camera there is no grid; `order` reports that.
        order = BurstOrder(frames=1) if grid is None else order_of(request, asked_ns, grid.period_ns)
        if grid is not None and order.streamed:
            is_open = request.frames is None and request.seconds is None
            lasts_ns = UNKNOWN_LENGTH_NS if is_open else order.frames * order.spacing * grid.period_ns
            if drift := drift_apart(grid, engine.roster.cameras(), asked_ns, lasts_ns):
                yield replace(before, message=drift)
        session = await self.order(order, name=request.name, note=request.note)
        for follower in self._options.followers:
            follower.follow_take(session)
        while not session.finished.is_set():
            yield session.status
            await has_come(session.finished, SNAPSHOT_EVERY_S)
        yield session.status

    async def order(self, order: BurstOrder, *, name: str = "", note: str = "") -> BurstSession:
        """Order a burst of all present nodes, and begin its session, which is named after the take.

        Raises BadInputError for an impossible burst or a folder that cannot be written, NoCameraHereError
        where there is no camera, DiskFullError where it will probably not fit here or on any node.
        """
        self._check_number(order.at_leader_ns)
        prefix = name or (RECORDING if order.video else UNNAMED)
        check_name(f"{prefix}-{MAX_FOLDER_NUMBER}", "take")
        self._engine.orders.check(self._engine.grid, order)
        cameras = self._engine.roster.cameras()
        # A recording may be stopped at any time.
        frames = min(order.frames, SURE_FRAMES) if order.video else order.frames
        root = self._options.sessions
        without = await asyncio.to_thread(check_room, root, cameras, self._image_bytes, frames, self.spools)
        if without and without.keys() >= {member.name for member in cameras}:
            raise DiskFullError(
                "; ".join(f"{self._engine.roster.title(name)}: {why}" for name, why in without.items()),
                hint="make room on that node, or take fewer frames",
            )
        # An abandoned number is never reused, because nodes may still know it.
        writer, folder = await asyncio.to_thread(
            create_numbered, root, prefix, after=self._last_folders.get(prefix, 0)
        )
        self._last_folders[prefix] = folder
        number = self._last_number = max(self._last_number + 1, folder if prefix == UNNAMED else 0)
        try:
            burst = self._engine.trigger(
                self.now_ns(), dataclasses.replace(order, number=number, without=without)
            )
        except SimulshotError:
            await asyncio.to_thread(writer.discard)
            raise
        session = BurstSession.begin(
            burst,
            {member.name: member.camera for member in self._engine.roster.by_name()},
            writer,
            self._disk,
            delays_ns=self._engine.planned_delays_ns(),
            short_timeouts=self._silent,
            absent={
                name: AbsentCamera(
                    name=name,
                    reason=why,
                    label=title if (title := self._engine.roster.title(name)) != name else "",
                )
                for name, why in (self._lost_cameras() | without).items()
            },
        )
        session.order_end = functools.partial(self._stop_cameras, session) if order.streamed else None
        self._bursts[number] = self.newest = session
        self._background.start(self._follow(session))
        # So that each captured frame can be fetched after a crash. Cameras do not wait for a slow disk.
        try:
            await session.write_plan(
                self._engine.config.instance,
                note,
                {
                    name: member.pin
                    for name, member in self._engine.roster.members.items()
                    if name in burst.clients
                },
                time.time_ns() - self.now_ns(),
            )
        except SimulshotError as error:
            # On a slow disk, nodes may have learned of it meanwhile.
            await self._cancel(session, error.what)
            raise
        self._pump.turn()
        return session

    def _lost_cameras(self) -> dict[str, str]:
        """Return the cameras that the rig had within FORGET_LOST_NS, and why they are not here.

        A name that never reported a frame was not one of its cameras.
        """
        now_ns, members = self.now_ns(), self._engine.roster.by_name()
        # A camera that has joined again takes part only once it has answered the welcome.
        here = {camera.name for camera in self._engine.roster.cameras()}
        absent: dict[str, str] = {}
        if now_ns < self._awaited_until_ns:
            awaited = sorted({*self._options.awaited} - here)
            absent = dict.fromkeys(awaited, "it has not come back since the leader was lost")
        for member in members:
            is_camera = member.camera.kind not in WITHOUT_CAMERA and member.has_taken
            if is_camera and member.name not in here and member.lost != LEFT:
                lost_s = (now_ns - member.last_heard_ns) // 10**9
                absent[member.name] = f"lost {lost_s} s before" if member.lost else "it is joining again"
        return absent

    @property
    def ahead(self) -> tuple[BurstStatus, ...]:
        """Ordered bursts that begin later than `SOON_NS` from now."""
        soon_ns = self.now_ns() + SOON_NS
        return tuple(
            BurstStatus(
                burst=session.burst.number,
                name=session.status.name,
                cameras=len(session.burst.clients),
                instants=session.burst.frames,
                received=0,
                expected=session.burst.frames * len(session.burst.clients),
                first_leader_ns=session.burst.instants_ns[0],
            )
            for session in self._bursts.values()
            if not session.finished.is_set() and session.burst.instants_ns[0] > soon_ns
        )

    def under_way(self) -> list[BurstSession]:
        """Return the bursts of this run that have begun, or begin soon, and are not saved yet."""
        ahead = {status.burst for status in self.ahead}
        of_now = (session for number, session in self._bursts.items() if number not in ahead)
        return [session for session in of_now if not session.finished.is_set()]

    def _check_number(self, at_leader_ns: int | None) -> None:
        """Raise IncompleteError if too many bursts are in progress, or ordered ahead."""
        is_ahead = at_leader_ns is not None and at_leader_ns > self.now_ns() + SOON_NS
        ahead = [burst.burst for burst in self.ahead]
        if is_ahead and len(ahead) >= MAX_BURSTS_AHEAD:
            raise IncompleteError(
                f"{len(ahead)} bursts are ordered ahead already: {', '.join(map(str, ahead))}",
                hint="wait for them, or cancel one: capture-app burst --cancel BURST",
            )
        if len(self.under_way()) >= MAX_OPEN_BURSTS:
            raise IncompleteError(
                f"{MAX_OPEN_BURSTS} bursts are still being saved", hint="wait until they are saved"
            )

    async def cancel(self, number: int) -> None:
        """Cancel a burst: nodes drop it, and images received so far are saved.

        Raises BadInputError where no such burst is in progress.
        """
        if (session := self._bursts.get(number)) is None or session.finished.is_set():
            raise BadInputError(
                f"burst {number} is not under way", hint="capture-app sessions list shows saved ones"
            )
        await self._cancel(session, "the burst was cancelled")

    async def _cancel(self, session: BurstSession, reason: str) -> None:
        self._cancelled.add(session.burst.number)
        self._engine.orders.cancel(session.burst, self.now_ns())
        self._pump.turn()
        await session.finish_now(reason, silent=False)

    async def end(self, number: int | None = None) -> None:
        """End a recording or a long burst now; None: the newest one. Raises BadInputError.

        A burst that is over already stays as it is: its operator learns of that only afterwards.
        """
        under_way = [session for session in self._bursts.values() if not session.finished.is_set()]
        numbers = {session.burst.number for session in under_way}
        if number is not None and 0 < number <= self._last_number and number not in numbers:
            return
        streamed = [session for session in under_way if session.burst.streamed]
        recordings = [session for session in streamed if number in (None, session.burst.number)]
        earlier = [session.status.name for session in self.resumed.sessions() if session.burst.streamed]
        if not recordings and not number and earlier:
            raise BadInputError(
                f"{earlier[-1]} was begun before the leader was restarted, and goes on to its ordered end",
                hint="to end it now, stop its nodes and start them again",
            )
        if not recordings:
            what = "no recording is" if number is None else f"burst {number} is not a recording"
            raise BadInputError(f"{what} under way", hint="capture-app status shows the current one")
        await self._end(recordings[-1])

    async def _end(self, session: BurstSession) -> None:
        """End a session's burst for its nodes and itself: an operator needs no frames after now."""
        frames = self._stop_cameras(session)
        if frames < session.burst.frames:
            await session.end(
                dataclasses.replace(session.burst, instants_ns=session.burst.instants_ns[:frames])
            )

    def _stop_cameras(self, session: BurstSession) -> int:
        """Order no further instants than every node can have learned of; return their number.

        The session accepts later ones: a camera that is not reached takes, and brings, as many as ordered.
        """
        frames = min(
            frames_until(session.burst, self.now_ns()),
            self._frames_of_ended.get(session.burst.number, session.burst.frames),
        )
        if frames < session.burst.frames:
            self._frames_of_ended[session.burst.number] = frames
            self._engine.orders.end(session.burst, frames, self.now_ns())
            self._pump.turn()
        return frames

    async def place_mark(self, mark: Mark) -> MarkPlaced:
        """Store a mark in the takes that it falls into; without one, in a file of the rig's.

        Raises BadInputError for a text that a mark cannot have, DiskError.
        """
        check_mark_text(mark.text)
        takes = [session for session in self._bursts.values() if session.contains(mark.leader_ns)]
        for session in takes:
            await session.place_mark(mark)
        if takes:
            return MarkPlaced(sessions=tuple(take.folder.name for take in takes))
        file = self._options.sessions / RIG_MARKS
        await asyncio.to_thread(append_mark, file, mark)
        return MarkPlaced(sessions=(), file=str(file))

    async def find_session(self, report: CameraReport, pin: str) -> BurstSession | ReportAck:
        """Return the burst of a report, from this run or an earlier one whose session lacks images.

        If that session has all images of this camera, return the answer without changing the session. `pin`
        identifies the machine that sends the report. Raises BadInputError where there is no such burst or its
        camera is another machine's, an UnwantedImageError where it was cancelled, TryAgainError where its
        session is in use.
        """
        of_this_run = report.leader == self._engine.config.instance
        session = self._bursts.get(report.burst) if of_this_run else None
        if session is None and (done := await self.resumed.answer_finished(report, pin)) is not None:
            return done
        if of_this_run and report.burst in self._cancelled:
            raise UnwantedImageError(f"burst {report.burst} was cancelled")
        if session is None or session.finished.is_set():
            session = await self.resumed.reopen(report, self.now_ns())
            if of_this_run and report.burst in self._frames_of_ended:
                # It was saved without its cameras, which were away when it ended and still take frames.
                self._stop_cameras(session)
        session.check_machine(report.camera, pin)
        return session

    def note_spool_space(self, space: SpoolSpace) -> None:
        """Store a node's free space for the next burst, and log a change of its spool's problem."""
        before = self.spools.get(space.camera)
        self.spools[space.camera] = space
        if space.problem != ("" if before is None else before.problem):
            self._event_log.say_of_disk(space.camera, space.problem)

    def report_progress(self, session: BurstSession) -> None:
        """Report a burst's progress at intervals; its completion is reported elsewhere, once."""
        if not session.finished.is_set() and self.now_ns() >= self._reported_ns + REPORT_INTERVAL_NS:
            self._reported_ns = self.now_ns()
            self._event_log.note(session.status)

    async def give_up(self, camera: str, reason: str) -> None:
        """Stop waiting for a camera in all bursts that are being saved."""
        for session in (*self._bursts.values(), *self.resumed.sessions()):
            await session.give_up_camera(camera, reason)

    def note_answer(self, answer: TriggerAnswered) -> None:
        """Note whether a node takes part in a burst."""
        if answer.refusal and (session := self._bursts.get(answer.burst)):
            self._background.start(
                session.give_up_camera(answer.name, answer.refusal, silent=answer.is_silent)
            )

    def _take_up(self, session: BurstSession) -> None:
        """Follow a session that was opened again, which is the newest one in a run that has ordered none."""
        if self.newest is None or self.newest.folder == session.folder:
            self.newest = session
        now_ns = self.now_ns()
        if (run := session.to_continue(now_ns, time.time_ns())) is not None:
            self._engine.resume(session.burst, run, session.planned_delays_ns(), now_ns)
            self._pump.turn()
        self._background.start(self._follow(session))

    async def _follow(self, session: BurstSession) -> None:
        self._event_log.note(session.status)
        await session.finished.wait()
        self._note_finished(session)

    def _note_finished(self, session: BurstSession) -> None:
        status = session.status
        path, number = status.session, session.burst.number
        if path is not None:
            self._image_bytes |= session.mean_image_bytes()
            if path not in self.saved:
                self.saved.append(path)
        if self._bursts.get(number) is session:
            if session.burst.streamed and number not in self._cancelled:
                # If the burst ended for another reason, such as a full disk, nodes still capture.
                self._stop_cameras(session)
            self._silent = (self._silent - {*session.burst.clients}) | session.silent_cameras()
            del self._bursts[number]
        if session.trouble:
            # It ended with it: that does not show that the disk is usable again.
            self._trouble = ""
        self._event_log.note(status)
        if isinstance(session.failure, DiskError) and status.burst not in self._cancelled:
            self._background.start(self.resumed.finish_later(session.folder, self.now_ns))

    async def look_at_disk(self) -> None:
        """Read the disk's free space at intervals, and name no session any more that was renamed or deleted.

        A disk that hangs, as a share may, must not stop the leader's clock.
        """
        now_ns = self.now_ns()
        if now_ns - self._looked_ns >= LOOK_EVERY_NS:
            self._looked_ns = now_ns
            if self._looking is None or self._looking.done():
                self._looking = asyncio.create_task(self._look())
            if not (await asyncio.wait({self._looking}, timeout=LOOK_TIMEOUT_S))[0]:
                self.free_bytes = None

    async def _look(self) -> None:
        try:
            self.free_bytes = await asyncio.to_thread(free_bytes, self._options.sessions)
        except DiskError:
            self.free_bytes = None
        await self.forget_moved()

    async def forget_moved(self) -> None:
        """Name no session in a status that was renamed or deleted since it was saved."""
        # A path that is too long raises nothing there.
        here = await asyncio.to_thread(lambda saved: {*filter(os.path.exists, saved)}, tuple(self.saved))
        for path in tuple(self.saved):
            if path not in here:
                self.saved.remove(path)

    async def give_up_silent_cameras(self) -> None:
        """Stop waiting for cameras that are silent, in all bursts that are being saved."""
        now_ns = self.now_ns()
        lost: Mapping[str, str] = {
            member.name: f"lost: {member.report.message}"
            for member in self._engine.roster.by_name()
            if member.report.state is NodeState.LOST
        }
        sessions = [*self._bursts.values(), *self.resumed.sessions()]
        # A camera sends one image after the other: it is waited for while it sends those of any burst.
        new_bytes = sum((session.new_bytes() for session in sessions), Counter[str]())
        for session in sessions:
            if not session.finished.is_set():
                await session.give_up_silent_cameras(lost, now_ns, new_bytes)
                if session.is_overrun(now_ns):
                    self._engine.orders.end(session.burst, session.burst.frames, now_ns)

    async def _watch_silence(self) -> None:
        while True:
            await asyncio.sleep(SILENCE_CHECK_S)
            await self.give_up_silent_cameras()
            sessions = (*self._bursts.values(), *self.resumed.sessions())
            trouble = next((session.trouble for session in sessions if session.trouble), "")
            if trouble != self._trouble:
                self._trouble = trouble
                self._event_log.say_of_disk(None, trouble)
