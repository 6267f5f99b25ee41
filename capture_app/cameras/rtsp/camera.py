"""An IP camera by RTSP: its video is decoded as it comes, and stamped by its sender's clock."""

import asyncio
import itertools
import time
from collections.abc import Coroutine, Mapping
from functools import partial
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING, Any

from capture_app.cameras.base import Camera, OnFailure, OnFrame
from capture_app.cameras.frames import CapturedFrame, PixelPicture, step_to
from capture_app.cameras.rtsp.connection import GONE, Connection, VideoStream
from capture_app.cameras.rtsp.packets import AccessUnit, AccessUnits, reported_ticks
from capture_app.cameras.rtsp.sender_clock import SenderClock
from capture_app.cameras.specs import read_request
from capture_app.cameras.threaded import ThreadedCamera
from capture_app.common.camera_facts import (
    CameraFacts,
    CameraListing,
    PhaseControl,
    StampAccuracy,
    StampSource,
    TimestampSource,
)
from capture_app.common.clock import NodeClock
from capture_app.common.errors import CameraError
from capture_app.common.optional_packages import load_optional
from capture_app.common.passwords import reveal_password
from capture_app.common.tasks import end
from capture_app.sync.wire.camera_commands import CameraCommand

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

KIND = "rtsp"
SPEC = "rtsp://USER@HOST/PATH[,key=value…]"
HELP = "IP cameras, by their addresses."
EXTRA = "rtsp"
NEEDS = f"PyAV: the extra {EXTRA}"
OPTIONS = {"fps": "its frames a second, where it does not say them and they are not whole"}
REPORTS_S, FIRST_REPORTS = 8.0, 2
"""So long, or for so many, sender reports are waited for; RFC 3550 has one come each 2.5 to 7.5 s."""
PICTURE_S, SILENCE_S, ASK_S = 30.0, 5.0, 2.0
FIRST_QUESTIONS, SOON_S = 25, 0.04
RATE_FRAMES, RATE_SHARE = 20, 0.05
"""How many frames tell whether a camera keeps the rate that it says, to within this share."""
DELIVERY_NS = 500_000_000
"""A frame arrives at most so long after it is read out, encoding it included; assumed, as no camera tells."""
MOST_WAITING = 30
"""Frames that wait to be decoded."""


def _pixels(frame: Any, width: int | None) -> "NDArray[np.uint8]":
    """The pixels of a decoded frame, in the format of its video; see `PixelPicture.pixels`."""
    import numpy as np
    from av.video.reformatter import VideoReformatter

    step = step_to(frame.width, width)
    # Its own reformatter: two threads may look at one picture.
    smaller = VideoReformatter().reformat(frame, frame.width // step, frame.height // step, "bgr24")
    return np.asarray(smaller.to_ndarray(), np.uint8)


class RtspCamera(ThreadedCamera):
    """An IP camera; it is connected when it is started, which takes seconds."""

    def __init__(self, url: str, fps: float | None = None, *, reports_s: float = REPORTS_S) -> None:
        """`reports_s` is how long sender reports are waited for. Raises BadInputError for a bad address."""
        super().__init__(KIND)
        self._connection = Connection(url)
        self._asked_fps, self._reports_s = fps, reports_s
        self._tasks: list[asyncio.Task[None]] = []
        self._waiting: asyncio.Queue[tuple[int, AccessUnit]] = asyncio.Queue(MOST_WAITING)
        """Each with its media time."""
        self._clock: SenderClock
        self._begun_with: list[int] = []
        """Media times of the first pictures, which are not delivered."""
        self._last_ns = self._sequence = 0
        self._has_failed = False
        self._begun_s = 0.0
        self._ready: asyncio.Future[None]

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Connect and stream. Raises CameraError where it is missing, refuses or sends no pictures."""
        self.listen(on_frame, on_failure)
        self._ready, self._begun_s = self._loop.create_future(), time.monotonic()
        try:
            await self._connection.open()
            ticks_per_s = self._connection.stream.ticks_per_s
            self._clock = SenderClock(ticks_per_s, self._connection.round_trips_ns)
            for work in (self._receive, self._decode, self._ask):
                self._tasks.append(asyncio.create_task(self._watched(work())))
            async with asyncio.timeout(PICTURE_S):
                await self._ready
        except TimeoutError as error:
            await self.stop()
            raise CameraError(f"{self._connection.host} sends no picture that can be decoded") from error
        except BaseException:
            await self.stop()
            raise

    async def apply(self, command: CameraCommand) -> None:
        """Raise CameraError: neither its phase nor its frames can be moved."""
        raise CameraError("an IP camera's stream cannot be moved")

    async def _let_go(self) -> None:
        tasks, self._tasks = self._tasks, []
        await end(*tasks)
        await self._connection.close()

    async def _watched(self, work: Coroutine[Any, Any, None]) -> None:
        try:
            await work
        except GONE as error:
            self._fail(f"{self._connection.host} is gone: {error or 'it hung up'}")
        except CameraError as error:
            self._fail(f"{self._connection.host} {error}")

    def _fail(self, what: str) -> None:
        error = CameraError(what, hint="it is tried again; check its power and cable")
        if not self._ready.done():
            self._ready.set_exception(error)
        elif self._tasks and not self._has_failed:
            self._has_failed = True
            self._on_failure(error)

    async def _ask(self) -> None:
        for number in itertools.count():
            self._connection.ask()
            await asyncio.sleep(SOON_S if number < FIRST_QUESTIONS else ASK_S)

    async def _receive(self) -> None:
        units = AccessUnits(self._connection.stream.codec, self._connection.stream.payload_type)
        while True:
            try:
                async with asyncio.timeout(SILENCE_S):
                    channel, data, arrival_ns = await self._connection.next_packet()
            except TimeoutError as error:
                raise CameraError("sends nothing any more") from error
            if channel == 1:
                for ticks in reported_ticks(data):
                    self._clock.add_report(ticks, arrival_ns)
                if self._clock.contradicts_itself:
                    raise CameraError("tells another time by its sender reports than before")
            else:
                for unit in units.add(data, arrival_ns):
                    await self._waiting.put((self._clock.add_frame(unit.ticks, unit.arrival_ns), unit))

    async def _decode(self) -> None:
        decoder = _Decoder(self._connection.stream)
        while True:
            media_ns, unit = await self._waiting.get()
            for picture_ns, picture in await self._in_worker(decoder.decode, media_ns, unit):
                if not self._ready.done():
                    self._begin(picture_ns, picture)
                else:
                    self._hand_on(picture_ns, picture)

    def _begin(self, media_ns: int, picture: Any) -> None:
        """Begin once the rate is known and sender reports have come or were waited for."""
        self._begun_with.append(media_ns)
        waited_s = time.monotonic() - self._begun_s
        if len(self._begun_with) <= RATE_FRAMES or (
            self._clock.reports < FIRST_REPORTS and waited_s < self._reports_s
        ):
            return
        follows = self._clock.follow_reports()
        codec = self._connection.stream.codec.upper().replace("HEVC", "H265")
        period_ns = round(1e9 / self._rate())
        # What is measured of its stamps holds for one way to time them.
        way = "sender reports" if follows else "arrival"
        half_ns = (2 * period_ns + DELIVERY_NS) // 2
        by_arrival = StampAccuracy(bias_ns=half_ns, uncertainty_ns=half_ns, source=StampSource.ASSUMED)
        self._facts = CameraFacts(
            kind=KIND,
            model=f"{self._connection.server or 'IP camera'}, timed by {way}"[:200],
            width=picture.width,
            height=picture.height,
            pixel_format=codec,
            period_ns=period_ns,
            timestamp_source=TimestampSource.UNKNOWN,
            phase_control=PhaseControl.NONE,
            stamp=None if follows else by_arrival,
        )
        self._last_ns = media_ns
        self._ready.set_result(None)

    def _rate(self) -> float:
        """Frames a second: as asked for or as the camera says, where it keeps to that; else as it is seen."""
        step_ns = median(after - before for before, after in pairwise(self._begun_with))
        if step_ns <= 0:
            raise CameraError("tells the same time of all its pictures")
        seen = 1e9 / step_ns
        told = self._asked_fps or self._connection.stream.fps
        if told and abs(seen / told - 1) <= RATE_SHARE:
            return told
        return round(seen) if abs(seen / max(1, round(seen)) - 1) <= RATE_SHARE else seen

    def _hand_on(self, media_ns: int, picture: Any) -> None:
        self._sequence += max(1, round((media_ns - self._last_ns) / self.facts.period_ns))
        self._last_ns = media_ns
        self._on_frame(
            CapturedFrame(
                sequence=self._sequence,
                stream=0,
                timestamp_ns=self._clock.host_ns(media_ns),
                picture=PixelPicture(
                    sum(plane.buffer_size for plane in picture.planes), partial(_pixels, picture)
                ),
                clock_uncertainty_ns=self._clock.uncertainty_ns(media_ns),
            )
        )


class _Decoder:
    """Decodes pictures in the order they come, none between a lost packet and the next whole picture."""

    def __init__(self, stream: VideoStream) -> None:
        av = load_av()
        self._av, self._is_damaged = av, True
        self._codec = av.CodecContext.create(stream.codec, "r")
        self._codec.extradata = stream.parameter_sets or None

    def decode(self, media_ns: int, unit: AccessUnit) -> list[tuple[int, Any]]:
        """The pictures, as PyAV has them, that a unit completes, each with its media time."""
        self._is_damaged |= not unit.whole
        packet = self._av.Packet(unit.data)
        packet.pts = media_ns
        try:
            frames = self._codec.decode(packet)
        except self._av.FFmpegError:
            self._is_damaged = True
            return []
        found = []
        for frame in frames:
            self._is_damaged &= not frame.key_frame
            if not self._is_damaged and frame.pts is not None:
                found.append((frame.pts, frame))
        return found


def load_av() -> Any:
    """PyAV. Raises NotAvailableError."""
    return load_optional("av", EXTRA, "an IP camera")


def open_camera(address: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> Camera:
    """Make an IP camera of the address behind `rtsp:`; it is connected when it is started.

    Raises BadInputError for an address or an option that cannot be read, NotAvailableError without PyAV.
    """
    fps = read_request(options, "an IP camera").fps
    load_av().logging.set_level(None)
    return RtspCamera(reveal_password(f"{KIND}:{address}"), fps).in_clock(clock)


def list_cameras() -> list[CameraListing]:
    """None: they are named by their addresses."""
    return []
