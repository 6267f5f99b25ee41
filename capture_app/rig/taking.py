"""Taking pictures with a running rig: the plan of a take, and its events until it is saved.

The command line, the screen and Python all use this, and differ only in their display of the events.
"""

import asyncio
import math
from collections import Counter, defaultdict
from collections.abc import AsyncGenerator, Coroutine
from contextlib import aclosing, suppress
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, Self

from msgspec import Struct
from msgspec.structs import force_setattr, replace

from capture_app.common.errors import (
    BadInputError,
    IncompleteError,
    NetworkError,
    NotAvailableError,
    SimulshotError,
)
from capture_app.common.names import typed_name
from capture_app.common.take_limits import LIMITS, check_before, limited
from capture_app.common.tasks import end
from capture_app.common.timeouts import READY_TIMEOUT_S
from capture_app.protocol.messages import BurstRequest
from capture_app.protocol.orders import CancelBurst, EndBurst
from capture_app.protocol.status import BurstStatus, RigStatus
from capture_app.rig.rig_link import RigLink, present_cameras
from capture_app.session.format.manifest import MANIFEST, Manifest
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verdict import Verdict, judge

if TYPE_CHECKING:
    from capture_app.session.reading.array_access import OpenSession

MAX_NOTE = 10_000
"""Letters of a note."""


class TakePlan(BurstRequest, frozen=True, kw_only=True, tag=False):
    """One take as requested from the leader, or a series of takes; times in seconds.

    With `video` or `seconds`, `frames` is not used. Raises BadInputError for values that no leader accepts,
    or that contradict each other.
    """

    frames: int = 5
    """Frames of each camera, including `before`."""
    countdown_s: float = 0.0
    """Delay before the first take, and before each take of a series that has no `every_s`."""
    repeat: int = 1
    """Number of takes."""
    every_s: float | None = None
    """Time from one take to the next, whether the last is saved or not; None: as soon as it is saved.

    With `on_motion` the minimum time.
    """
    on_motion: tuple[float, float, float, float] | None = None
    """Take when something moves in this region: left, top, right and bottom as fractions of the image."""
    wait_leader_s: float = 120.0
    """Timeout for a leader that is lost during a take."""

    def __post_init__(self) -> None:
        """Raise BadInputError for values that no leader accepts, or that contradict each other."""
        for field in LIMITS:
            if (value := getattr(self, field)) is not None:
                force_setattr(self, field, limited(field, value))
        check_before(self.before, None if self.is_by_duration else self.frames)
        if not isinstance(self.note, str) or len(self.note) > MAX_NOTE:
            raise BadInputError("the note of a take is not a text", hint=f"give up to {MAX_NOTE} letters")
        if self.name:
            force_setattr(self, "name", typed_name(self.name, "take"))
        if self.at_leader_ns is not None and (self.repeat > 1 or self.on_motion is not None):
            raise BadInputError(
                "a take at a given time cannot be repeated or wait for motion",
                hint="leave out the time, or take one burst without motion",
            )
        left, top, right, bottom = self.on_motion or (0, 0, 1, 1)
        if not (0 <= left < right <= 1 and 0 <= top < bottom <= 1):
            raise BadInputError(
                f"{self.on_motion} is not a region of the image",
                hint="give LEFT TOP RIGHT BOTTOM, for example 0.5 0 1 1 for the right half",
            )

    @property
    def is_by_duration(self) -> bool:
        """Whether the take ends by its time or by an order, not by its number of frames."""
        return self.video or self.seconds is not None

    def request(self) -> BurstRequest:
        """Return the leader's order of one take; a take by its duration skips no instants."""
        fields = {field: getattr(self, field) for field in BurstRequest.__struct_fields__}
        if self.is_by_duration:
            fields |= {"frames": None, "spare": 0}
        return BurstRequest(**fields)

    def when_ready(self, status: RigStatus | None) -> Self:
        """Return this plan, with a wait until all cameras are ready if one of them is settling.

        A take on motion does not wait: its time is known before, and would be over.
        """
        if status is None or self.on_motion is not None or not any(n.is_settling for n in status.cameras):
            return self
        return replace(self, wait_ready_s=READY_TIMEOUT_S, nodes=len(present_cameras(status)))


class TakeEvent(Struct, frozen=True):
    """Something that happens during a take; the takes of a series are numbered from 1."""

    number: int


class Countdown(TakeEvent, frozen=True):
    """The take, or the wait for motion, begins in this many seconds."""

    seconds: int


class Moved(TakeEvent, frozen=True):
    """Something moves in front of this camera: the take is ordered."""

    camera: str


class Waiting(TakeEvent, frozen=True):
    """The take waits; the text gives the reason: the rig is not ready, or nothing moves."""

    reason: str


class Begun(TakeEvent, frozen=True):
    """The leader takes the pictures; `Progress` follows."""


class Progress(TakeEvent, frozen=True):
    """The take is under way, or over; `status.message` says whether the leader is lost."""

    status: BurstStatus


class Saved(TakeEvent, frozen=True):
    """The take is saved; `verdict` is None where the session is not on this machine."""

    status: BurstStatus
    verdict: Verdict | None = None

    @property
    def session(self) -> str | None:
        """Path of the session on the leader's machine."""
        return self.status.session

    def open(self) -> "OpenSession":
        """Open the session. Raises NotAvailableError where it is on another machine."""
        from capture_app.session.reading.array_access import OpenSession

        session = local_session(self.status)
        if session is None:
            raise NotAvailableError(
                f"the images are on the leader: {self.session}",
                hint="copy that folder to this machine, and open the copy",
            )
        return OpenSession.open(session.folder)


class Failed(TakeEvent, frozen=True):
    """The take failed, or the connection to it was lost; `status` is the last one, if it had begun."""

    error: SimulshotError
    status: BurstStatus | None = None


def local_session(status: BurstStatus) -> Session | None:
    """Return the session of a finished take; None if it is not on this machine. Blocks on the disk.

    Raises BadInputError or IncompleteError where the session cannot be read.
    """
    if status.session is None or not (Path(status.session) / MANIFEST).is_file():
        return None
    session = Session.open(Path(status.session))
    # A leader on another machine may have a folder of the same path.
    return session if session.manifest.name == status.name else None


class Taking:
    """The takes of a plan in progress: iterate over the events, once.

    Leaving or cancelling the iteration ends everything here, but no burst that has begun at the leader. A
    failed take ends the series; with an interval or on motion it continues, unless the first take failed.
    """

    def __init__(self, link: RigLink, plan: TakePlan) -> None:
        self.plan = plan
        self._link = link
        self._events: asyncio.Queue[TakeEvent | BaseException | None] = asyncio.Queue()
        self._tasks: set[asyncio.Task[None]] = set()
        self._series: asyncio.Task[None] | None = None
        self._orders: dict[int, tuple[asyncio.Task[None], BurstRequest]] = {}
        self._waiting: set[int] = set()
        """Numbers of the takes for which the leader waits until the rig is ready."""
        self._active: dict[int, BurstStatus] = {}
        """Status of the takes that have begun and are not saved, by number."""
        self._begun = defaultdict[int, asyncio.Event](asyncio.Event)
        """By number, set when the take has begun or failed."""
        self._over = defaultdict[int, asyncio.Event](asyncio.Event)
        """By number, set when the take is saved or has failed."""

    async def __aiter__(self) -> AsyncGenerator[TakeEvent, None]:
        """Take, and yield each event, until all takes are saved or have failed."""
        self._series = self._start(self._run_series())
        try:
            while (event := await self._events.get()) is not None:
                if isinstance(event, BaseException):
                    raise event
                yield event
        finally:
            await end(*self._tasks)

    async def result(self) -> Saved:
        """Take, and return the last take of the series that was saved. Raises the first error of a take."""
        events = [event async for event in self]
        if error := next((event.error for event in events if isinstance(event, Failed)), None):
            raise error
        saved = [event for event in events if isinstance(event, Saved)]
        if not saved:
            raise IncompleteError("the take was stopped before it began")
        # At an interval, takes may be saved in another order than they were taken.
        return max(saved, key=lambda event: event.number)

    @property
    def is_open(self) -> bool:
        """Whether any take has not begun yet."""
        return bool(self._waiting) or not (self._series is None or self._series.done())

    @property
    def is_waiting(self) -> bool:
        """Whether the leader waits for the rig to become ready."""
        return bool(self._waiting)

    def take_now(self) -> None:
        """Stop waiting for the rig to become ready, both now and later in the series."""
        self.plan = replace(self.plan, wait_ready_s=0.0)
        for number in self._waiting:
            task, request = self._orders[number]
            task.cancel()
            self._order(number, replace(request, wait_ready_s=0.0))
        self._waiting.clear()

    def stop(self) -> None:
        """Begin no more takes, and follow those in progress until they are saved."""
        if self._series is not None:
            self._series.cancel()
        for number in self._waiting:
            self._orders[number][0].cancel()
        self._waiting.clear()

    async def end(self) -> None:
        """Stop, and end the recordings that have begun; they are followed until they are saved."""
        self.stop()
        for status in tuple(self._active.values()):
            await self._link.order(EndBurst(burst=status.burst))

    async def cancel(self) -> None:
        """Stop, and cancel the takes that have begun; images received so far are saved."""
        self.stop()
        for status in tuple(self._active.values()):
            await self._link.order(CancelBurst(burst=status.burst))

    def _start(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._note_end)
        return task

    def _note_end(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self._events.put_nowait(error)
        elif not self._tasks:
            self._events.put_nowait(None)

    async def _run_series(self) -> None:
        """Count down to each take and order it; with an interval, even while the last one is being saved."""
        plan, now = self.plan, asyncio.get_running_loop().time
        due_s = now() + plan.countdown_s
        for number in range(1, plan.repeat + 1):
            while (left_s := due_s - now()) > 0:
                seconds = math.ceil(left_s)
                self._events.put_nowait(Countdown(number, seconds))
                # Until the next whole second, so that each number is correct when it is shown.
                await asyncio.sleep(max(left_s - (seconds - 1), 0.001))
            request = self.plan.request()
            if plan.on_motion is not None:
                self._events.put_nowait(Waiting(number, "waiting for something to move"))
                from capture_app.rig.motion_watch import MotionWatch, watch_motion  # heavy: it decodes images

                watch = MotionWatch(plan.on_motion)
                async with aclosing(watch_motion(self._link.another(), watch)) as moving:
                    seen = await anext(moving)
                self._events.put_nowait(Moved(number, seen.camera))
                request = replace(self.plan.request(), at_leader_ns=seen.leader_ns)
            begun_s = now()
            self._order(number, request)
            if plan.every_s is not None and plan.on_motion is None:
                # Two takes that wait for the rig would begin in any order.
                await self._begun[number].wait()
                due_s = (due_s if now() < due_s + plan.every_s else now()) + plan.every_s
            elif number < plan.repeat:
                await self._over[number].wait()
                due_s = now() + plan.countdown_s
                if plan.on_motion is not None:
                    due_s = max(now(), begun_s + (plan.every_s or 0.0))

    def _order(self, number: int, request: BurstRequest) -> None:
        self._orders[number] = (self._start(self._follow(number, request)), request)

    async def _follow(self, number: int, request: BurstRequest) -> None:
        event: TakeEvent
        try:
            event = await _judge(number, await self._wait_until_over(number, request))
        except SimulshotError as error:
            event = Failed(number, error, self._active.get(number))
            goes_on = self.plan.every_s is not None or self.plan.on_motion is not None
            if self._series is not None and not (goes_on and number > 1):
                self._series.cancel()
        self._waiting.discard(number)
        self._active.pop(number, None)
        self._events.put_nowait(event)
        self._begun[number].set()
        self._over[number].set()

    async def _wait_until_over(self, number: int, request: BurstRequest) -> BurstStatus:
        """Order a take, report its progress, and return its last status. Raises the leader's errors."""
        last: BurstStatus | None = None
        try:
            async for last in self._link.burst(request):
                if last.name or last.done:
                    self._note(number, last)
                else:
                    self._waiting.add(number)
                    self._events.put_nowait(Waiting(number, last.message))
        except NetworkError as error:
            if number not in self._active:
                raise
            return await self._find_again(number, self._active[number], error)
        if last is None:
            raise NetworkError(
                f"the leader at {self._link.leader} did not accept the burst",
                hint=f"see its state: capture-app status --leader {self._link.leader}",
            )
        return last

    def _note(self, number: int, status: BurstStatus) -> None:
        """Report the progress of a take that has begun."""
        self._waiting.discard(number)
        if number not in self._active:
            self._begun[number].set()
            self._events.put_nowait(Begun(number))
        self._active[number] = status
        self._events.put_nowait(Progress(number, status))

    async def _find_again(self, number: int, last: BurstStatus, error: NetworkError) -> BurstStatus:
        """Follow a take after the connection to its leader was lost, in the rig's status once that is back.

        The take may have continued, or resume when the leader restarts.

        Raises NetworkError on timeout.
        """
        self._note(number, replace(last, message=f"{error.what}; the take may go on there"))
        # Another run of the leader has other numbers: an order to end this take would end another.
        self._active[number] = replace(last, burst=0)
        now, wait_s = asyncio.get_running_loop().time, self.plan.wait_leader_s
        with suppress(TimeoutError):
            async with asyncio.timeout(wait_s) as limit, aclosing(self._link.another().updates()) as updates:
                async for update in updates:
                    if isinstance(update, RigStatus) and (burst := _find(update, last)) is not None:
                        self._note(number, burst)
                        if burst.done:
                            return burst
                        limit.reschedule(now() + wait_s)
        raise NetworkError(
            f"the leader was lost after {last.received} of {last.expected} images of {last.name} had arrived",
            hint="it may have saved the take: check with capture-app sessions list on its machine",
        ) from error


def _find(rig: RigStatus, lost: BurstStatus) -> BurstStatus | None:
    """Return the status of a lost take from the rig's status; None if it is unknown there."""
    if rig.burst is not None and rig.burst.name == lost.name:
        return rig.burst
    path = next((path for path in rig.sessions if PurePath(path).name == lost.name), None)
    return (
        None
        if path is None
        else replace(lost, done=True, session=path, message="saved after its leader was lost")
    )


def _as_stored(status: BurstStatus, manifest: Manifest) -> BurstStatus:
    """Return a status that counts the images of its session against what was ordered.

    What a leader reported before it was lost counts neither.
    """
    images = Counter(image.camera for image in manifest.images)
    ordered = manifest.ordered_instants
    return replace(
        status,
        instants=ordered,
        received=images.total(),
        expected=manifest.expected_images,
        transfer=tuple(
            replace(part, received=images[part.camera], expected=ordered) for part in status.transfer
        ),
    )


async def _judge(number: int, status: BurstStatus) -> Saved | Failed:
    """Judge a finished take, if its session is on this machine."""
    if status.session is None and status.burst:
        error = IncompleteError(
            f"{status.name} is incomplete: {status.message}",
            hint="see which cameras are connected: capture-app status",
        )
        return Failed(number, error, status)
    with suppress(SimulshotError):
        if (session := await asyncio.to_thread(local_session, status)) is not None:
            manifest = session.manifest
            return Saved(number, _as_stored(status, manifest), judge(manifest, arriving=session.is_arriving))
    return Saved(number, status)
