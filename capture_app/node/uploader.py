"""Brings a node's images to the leader and keeps each until the leader has it safely on disk."""

import asyncio
import contextlib
import hashlib
import os
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import msgspec

from capture_app.cameras.base import CapturedFrame
from capture_app.errors import NetworkError
from capture_app.net.address import Address
from capture_app.net.transfer import Channel, connect
from capture_app.node.messages import CameraReport, FromLeader, ImageUpload, Noted, Refusal, Stored
from capture_app.session.manifest import ImageRecord, MissingImage, image_path
from capture_app.session.rows import exposure_start_ns
from capture_app.sync.trigger import Pick

RETRY_S = (0.5, 1.0, 2.0, 4.0)
ANSWER_TIMEOUT_S = 30.0
MAX_WAITING_BURSTS = 64
LOW_PRIORITY = 10
"""Niceness of the thread that develops pictures: the clock exchange comes first."""

Talk = Callable[[str], None]


@dataclass(slots=True)
class _Developed:
    """The bytes of a picked frame, ready to send as often as it takes."""

    upload: ImageUpload
    image: bytes
    truth: bytes


@dataclass(slots=True)
class BurstWork:
    """A burst's frames on their way to the leader."""

    report: CameraReport
    picks: deque[Pick[CapturedFrame]]
    developed: _Developed | None = None
    reported: bool = False


class _DevelopError(Exception):
    """A frame that could not be turned into an image file."""


@dataclass(slots=True)
class Uploader:
    """Sends bursts in their order, one image at a time, over a stream that it reopens when it breaks."""

    talk: Talk
    leader: Address | None = None
    _waiting: deque[BurstWork] = field(default_factory=deque)
    _news: asyncio.Event = field(default_factory=asyncio.Event)
    _developer: ThreadPoolExecutor = field(
        default_factory=lambda: ThreadPoolExecutor(1, "develop", initializer=_lower_priority)
    )

    def add(self, work: BurstWork) -> None:
        """Take on a burst; the oldest is given up where a leader has been away for too many."""
        self._waiting.append(work)
        if len(self._waiting) > MAX_WAITING_BURSTS:
            given_up = self._waiting.popleft()
            self.talk(f"burst {given_up.report.burst} given up: the leader is away for too long")
        self._news.set()

    async def run(self) -> None:
        """Send for ever."""
        failures = 0
        try:
            while True:
                while not self._waiting or self.leader is None:
                    self._news.clear()
                    await self._news.wait()
                try:
                    async with await connect(self.leader, FromLeader) as channel:
                        while self._waiting:
                            await self._send_burst(channel, self._waiting[0])
                            self._waiting.popleft()
                            failures = 0
                except NetworkError as error:
                    if not failures:
                        self.talk(f"images wait: {error}")
                    await asyncio.sleep(RETRY_S[min(failures, len(RETRY_S) - 1)])
                    failures += 1
        finally:
            self._developer.shutdown(wait=False, cancel_futures=True)

    def leader_found(self, leader: Address) -> None:
        """Images go to that address from now on."""
        self.leader = leader
        self._news.set()

    async def _send_burst(self, channel: Channel[Any], work: BurstWork) -> None:
        # A leader that was away has kept what it acknowledged; only the stream's own state is new.
        work.reported = False
        while not work.reported or work.picks:
            if not work.reported:
                if await self._is_over(channel, work, work.report):
                    return
                work.reported = True
                continue
            try:
                developed = work.developed or await self._develop(work.report, work.picks[0])
            except _DevelopError as error:
                instant = work.picks.popleft().instant
                lost = MissingImage(camera=work.report.camera.name, instant=instant, reason=str(error))
                work.report = _without(work.report, lost)
                work.reported = False
                self.talk(f"burst {work.report.burst}: instant {instant} is lost: {error}")
                continue
            work.developed = developed
            if await self._is_over(channel, work, developed.upload, developed.image, developed.truth):
                return
            work.picks.popleft()
            work.developed = None

    async def _is_over(
        self, channel: Channel[Any], work: BurstWork, message: msgspec.Struct, *payloads: bytes
    ) -> bool:
        """Send a part of a burst and wait until the leader has it; True where the leader wants no more."""
        try:
            async with asyncio.timeout(ANSWER_TIMEOUT_S):
                await channel.send(message, *payloads)
                received = await channel.receive()
        except TimeoutError as error:
            raise NetworkError(f"the leader did not take an image within {ANSWER_TIMEOUT_S:g} s") from error
        match received:
            case None:
                raise NetworkError("the leader closed the stream")
            case (Noted(), _) if isinstance(message, CameraReport):
                return False
            case (Stored(sha256=sha256), _) if isinstance(message, ImageUpload):
                if sha256 != message.record.sha256:
                    raise NetworkError("the leader stored other bytes than were sent")
                return False
            case (Refusal() as refusal, _):
                self.talk(f"burst {work.report.burst} given up: {refusal.what}")
                work.picks.clear()
                return True
        raise NetworkError("the leader answered something else than was asked")

    async def _develop(self, report: CameraReport, pick: Pick[CapturedFrame]) -> _Developed:
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._developer, _develop, report, pick)


def _develop(report: CameraReport, pick: Pick[CapturedFrame]) -> _Developed:
    frame = pick.frame
    try:
        image = frame.payload.encode()
        truth = b"" if frame.truth is None else frame.truth.encode()
    except Exception as error:
        # Drivers and encoders raise what they like; one bad frame must not end the node.
        raise _DevelopError(f"the frame could not be developed: {error}") from error
    camera, name = report.camera, report.camera.name
    tolerance_ns = camera.phase.tolerance_ns if camera.phase else None
    record = ImageRecord(
        camera=name,
        instant=pick.instant,
        path=image_path(name, pick.instant),
        leader_ns=pick.leader_ns,
        bytes=len(image),
        sha256=hashlib.sha256(image).hexdigest(),
        local_ns=pick.local_ns,
        residual_ns=pick.residual_ns,
        uncertainty_ns=pick.uncertainty_ns,
        hard_bound_ns=pick.hard_bound_ns,
        exposure_start_ns=exposure_start_ns(camera, pick.leader_ns, frame.exposure_ns),
        exposure_ns=frame.exposure_ns,
        gain=frame.gain,
        white_balance=frame.white_balance,
        sequence=frame.sequence,
        late=tolerance_ns is not None and abs(pick.residual_ns) > tolerance_ns,
    )
    true_ns = None if frame.truth is None else frame.truth.true_ns
    upload = ImageUpload(
        leader=report.leader, burst=report.burst, record=record, truth_bytes=len(truth), true_ns=true_ns
    )
    return _Developed(upload, image, truth)


def _without(report: CameraReport, lost: MissingImage) -> CameraReport:
    instants = tuple(instant for instant in report.instants if instant != lost.instant)
    return msgspec.structs.replace(report, instants=instants, missing=(*report.missing, lost))


def _lower_priority() -> None:
    # Linux knows a niceness for each thread; where there is none, all threads stay equal.
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), LOW_PRIORITY)
