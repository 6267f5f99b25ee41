"""IP camera over RTSP: its video is decoded on arrival and stamped by its sender's clock.

Host times come from its sender reports, or from the earliest arrivals.
"""

import asyncio
import itertools
from collections.abc import Coroutine, Mapping, Sequence
from functools import partial
from itertools import pairwise
from statistics import mean, median
from typing import TYPE_CHECKING, Any

from capture_app.cameras.arrival_clock import ArrivalClock
from capture_app.cameras.base import Camera, OnFailure, OnFrame, ThreadedCamera
from capture_app.cameras.frames import CapturedFrame, PixelPicture, step_to
from capture_app.cameras.specs import read_request
from capture_app.common import system
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
from capture_app.common.host_clock import host_from_monotonic
from capture_app.common.optional_packages import load_optional
from capture_app.common.passwords import reveal_password
from capture_app.common.tasks import end
from capture_app.plugins.cameras.rtsp.connection import (
    DISCONNECTED,
    AccessUnit,
    AccessUnits,
    Connection,
    reported_ticks,
)
from capture_app.plugins.cameras.rtsp.rtsp_sound import RATE_HZ, RtspMicrophone, parse_sound
from capture_app.sync.wire.camera_commands import CameraCommand

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

KIND = "rtsp"
SPEC = "rtsp://USER@HOST/PATH[,key=value…]"
HELP = "IP cameras, by their addresses."
EXTRA = "rtsp"
NEEDS = f"PyAV: the extra {EXTRA}"
OPTIONS = {
    "fps": "its frames a second, where it does not say them and they are not whole",
    "basic": "yes sends it the password in clear text if it asks for that; default: refuse",
}
REPORTS_S, FIRST_REPORTS = 8.0, 2
"""Max wait for sender reports, and the number to wait for; RFC 3550 sends one every 2.5 to 7.5 s."""
PICTURE_S, SILENCE_S = 30.0, 5.0
RATE_FRAMES, RATE_FRACTION = 20, 0.05
"""Number of frames by which a camera's stated rate is checked, and the relative tolerance."""
DELIVERY_NS = 500_000_000
"""Max delay from a frame's readout to its arrival, encoding included; assumed, as no camera reports it."""
MAX_PIXELS = 1 << 25
"""Largest picture that is decoded, px: 8K."""
_LATEST_NS, _CHANGE_NS = 2_000_000_000, 200_000_000
_EARLIEST_NS = 5_000_000
"""Reports are credible if frames arrive at most 5 ms early or 2 s late by them, changing by at most 0.2 s."""
_HALF = 1 << 31


class SenderClock:
    """Maps a stream's RTP timestamps to the host's monotonic clock; media times are ns since its beginning.

    A sender report shows the stream's clock at the moment of sending, whatever the camera's wall clock shows.
    Its network delay is at least zero. For a quick report it is at most the minimum round trip of a request
    to that camera. The estimate takes the middle. A frame's own arrival also includes the camera's encoding
    and the link's transmission time. Nothing measures those, so they stay in its time.
    """

    def __init__(self, ticks_per_s: int, round_trips_ns: Sequence[int]) -> None:
        """Create the clock; `round_trips_ns` grows by each round trip of a request to the camera."""
        self._ticks_per_s, self._round_trips_ns = ticks_per_s, round_trips_ns
        self._first: int | None = None
        self._by_frames, self._by_reports = ArrivalClock(), ArrivalClock()
        self._last_frame_ticks: int | None = None
        self.reports = 0
        """Number of reports that carry their moment of sending."""
        self._typical_ns: int | None = None
        """Minimum delay from a frame to its arrival, by the reports; None until reports are followed."""

    def media_ns(self, ticks: int) -> int:
        """Return the media time of an RTP timestamp near the newest one; handles wrap-around."""
        if self._first is None:
            self._first = self._newest = ticks
        step = (ticks - self._newest + _HALF) % (2 * _HALF) - _HALF
        self._newest = max(self._newest, self._newest + step)
        return (self._newest + min(step, 0) - self._first) * 1_000_000_000 // self._ticks_per_s

    def add_frame(self, ticks: int, arrival_ns: int) -> int:
        """Add the arrival of a frame's first packet; return its media time."""
        self._last_frame_ticks = ticks
        media_ns = self.media_ns(ticks)
        self._by_frames.add_arrival(media_ns, arrival_ns)
        return media_ns

    def add_report(self, ticks: int, arrival_ns: int) -> None:
        """Add a report: its reading of the stream's clock, and its arrival."""
        # Some cameras repeat the last frame's timestamp instead of the report's own.
        if ticks != self._last_frame_ticks and self._first is not None:
            self.reports += 1
            if self._round_trips_ns:
                self._by_reports.typical_excess_ns = mean(self._round_trips_ns) - min(self._round_trips_ns)
            self._by_reports.add_arrival(self.media_ns(ticks), arrival_ns)

    def follow_reports(self) -> bool:
        """Use the reports from now on if they are credible; return whether they are."""
        frames_take_ns = self._frames_take_ns()
        if frames_take_ns is not None and -_EARLIEST_NS <= frames_take_ns <= _LATEST_NS:
            self._typical_ns = frames_take_ns
        return self._typical_ns is not None

    @property
    def contradicts_itself(self) -> bool:
        """Whether the reports in use now give the frames a different time than before."""
        now_ns, typical_ns = self._frames_take_ns(), self._typical_ns
        return typical_ns is not None and now_ns is not None and abs(now_ns - typical_ns) > _CHANGE_NS

    def host_ns(self, media_ns: int) -> int:
        """Return the host's time of a frame that was added."""
        clock = self._by_frames if self._typical_ns is None else self._by_reports
        found_ns = clock.host_ns(media_ns)
        assert found_ns is not None
        return found_ns - (0 if self._typical_ns is None else self._half_round_trip_ns)

    def uncertainty_ns(self, media_ns: int) -> int:
        """Return its 95 % error; without reports in use, the frames' minimum delay is left out."""
        if self._typical_ns is None:
            # Encoding and transmission hardly ever both take their minimum time.
            return self._by_frames.uncertainty_ns(media_ns) + round(self._by_frames.jitter_ns)
        return self._half_round_trip_ns + self._by_reports.uncertainty_ns(media_ns)

    @property
    def _half_round_trip_ns(self) -> int:
        return min(self._round_trips_ns, default=0) // 2

    def _frames_take_ns(self) -> int | None:
        newest_ns = 0 if self._first is None else self.media_ns(self._newest)
        by_frames_ns, by_reports_ns = self._by_frames.host_ns(newest_ns), self._by_reports.host_ns(newest_ns)
        return (
            None
            if by_frames_ns is None or by_reports_ns is None
            else by_frames_ns - by_reports_ns + self._half_round_trip_ns
        )


def _pixels(frame: Any, width: int | None) -> "NDArray[np.uint8]":
    """Return the pixels of a decoded frame, in the format of its video; see `PixelPicture.pixels`."""
    import numpy as np
    from av.video.reformatter import VideoReformatter

    step = step_to(frame.width, width)
    # Its own reformatter, because two threads may read one image.
    smaller = VideoReformatter().reformat(frame, frame.width // step, frame.height // step, "bgr24")
    return np.asarray(smaller.to_ndarray(), np.uint8)


class RtspCamera(ThreadedCamera):
    """An IP camera; it is connected when it is started, which takes seconds."""

    def __init__(
        self,
        url: str,
        fps: float | None = None,
        *,
        reports_s: float = REPORTS_S,
        allows_basic: bool = False,
    ) -> None:
        """Create the camera; it waits up to `reports_s` for sender reports. Raises BadInputError.

        With `allows_basic`, a camera that asks for it gets the password in clear text.
        """
        super().__init__(KIND)
        self._connection = Connection(url, allows_basic=allows_basic)
        self._asked_fps, self._reports_s = fps, reports_s
        self._tasks: list[asyncio.Task[None]] = []
        self._waiting: asyncio.Queue[tuple[int, AccessUnit]] = asyncio.Queue(30)
        """Access units with their media times, which wait for the decoder."""
        self._clock: SenderClock
        self._begun_with: list[int] = []
        """Media times of the first frames, which are not delivered."""
        self._last_ns = self._sequence = 0
        self._is_damaged = True
        self._microphone: RtspMicrophone | None = None
        self._sound_clock: SenderClock

    @property
    def microphone(self) -> RtspMicrophone:
        """The camera's microphone, which is received if it was asked for before the start."""
        if self._microphone is None:
            self._microphone = RtspMicrophone(self._connection.host)
            self._connection.find_sound = self._find_sound
        return self._microphone

    def _find_sound(self, description: str) -> str:
        sound = parse_sound(description)
        self.microphone.begin(sound)
        self._sound_clock = SenderClock(RATE_HZ, self._connection.round_trips_ns)
        return sound.control if sound else ""

    def _hear(self, channel: int, data: bytes, arrival_ns: int) -> None:
        """Take a packet of the sound, or its sender report; its times are like frame times."""
        clock = self._sound_clock
        if channel == 3:
            for ticks in reported_ticks(data):
                clock.add_report(ticks, arrival_ns)
        elif (first_ticks := self.microphone.ticks_of(data)) is not None:
            media_ns = clock.add_frame(first_ticks, arrival_ns)
            # Frames wait for reports, too.
            if self._begun.done():
                is_begin, at_ns = clock.follow_reports(), host_from_monotonic(clock.host_ns(media_ns))
                self.microphone.hear(data, self._clock_of_node.local_from_true(at_ns), is_begin=is_begin)

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Connect and stream. Raises CameraError if it is missing, refuses or sends no frames."""
        self.listen(on_frame, on_failure)
        self._begun_s = system.monotonic_s()
        try:
            await self._connection.open()
            self._clock = SenderClock(self._connection.stream.ticks_per_s, self._connection.round_trips_ns)
            self._tasks = [
                asyncio.create_task(self._watched(work))
                for work in (self._receive(), self._decode(), self._ask())
            ]
            async with asyncio.timeout(PICTURE_S):
                await self._begun
        except TimeoutError as error:
            await self.stop()
            raise CameraError(
                f"{self._connection.host} sends no picture that can be decoded",
                hint="set it to H.264 or H.265, with a key frame every second",
            ) from error
        except BaseException:
            await self.stop()
            raise

    async def apply(self, command: CameraCommand) -> None:
        """Raise CameraError: an IP camera's phase and frame durations cannot be changed."""
        raise CameraError("an IP camera's stream cannot be moved")

    async def _let_go(self) -> None:
        await end(*self._tasks)
        await self._connection.close()

    async def _watched(self, work: Coroutine[Any, Any, None]) -> None:
        try:
            await work
        except (*DISCONNECTED, CameraError) as error:
            lost = CameraError(f"is gone: {str(error) or 'it hung up'}")
            known = error if isinstance(error, CameraError) else lost
            hint = known.hint or "it is tried again; check its power and cable"
            self._fail(CameraError(f"{self._connection.host} {known.what}", hint=hint))

    async def _ask(self) -> None:
        for number in itertools.count():
            self._connection.ask()
            await asyncio.sleep(0.04 if number < 25 else 2.0)

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
                    raise CameraError(
                        "jumps in time: its sender reports contradict earlier ones",
                        hint="it is tried again; restart the camera if that repeats",
                    )
            elif channel in (2, 3) and self._microphone is not None:
                self._hear(channel, data, arrival_ns)
            else:
                for unit in units.add(data, arrival_ns):
                    await self._waiting.put((self._clock.add_frame(unit.ticks, unit.arrival_ns), unit))

    async def _decode(self) -> None:
        codec = load_av().CodecContext.create(self._connection.stream.codec, "r")
        codec.extradata = self._connection.stream.parameter_sets or None
        codec.options = {"max_pixels": str(MAX_PIXELS)}
        while True:
            media_ns, unit = await self._waiting.get()
            for picture in await self._in_worker(self._pictures, codec, media_ns, unit):
                if not self._begun.done():
                    self._begin(picture.pts, picture)
                else:
                    self._hand_on(picture.pts, picture)

    def _pictures(self, codec: Any, media_ns: int, unit: AccessUnit) -> list[Any]:
        """Return the frames, as PyAV objects with their media times, that a unit completes.

        After a lost packet, all frames up to the next key frame are dropped.
        """
        av = load_av()
        self._is_damaged |= not unit.whole
        packet = av.Packet(unit.data)
        packet.pts = media_ns
        try:
            frames = codec.decode(packet)
        except av.FFmpegError:
            self._is_damaged = True
            return []
        packets = []
        for frame in frames:
            self._is_damaged &= not frame.key_frame
            if not self._is_damaged and frame.pts is not None:
                packets.append(frame)
        return packets

    def _begin(self, media_ns: int, picture: Any) -> None:
        """Start delivery once the rate is known, and sender reports have arrived or timed out."""
        self._begun_with.append(media_ns)
        more_reports = (
            self._clock.reports < FIRST_REPORTS and system.monotonic_s() - self._begun_s < self._reports_s
        )
        if len(self._begun_with) <= RATE_FRAMES or more_reports:
            return
        follows, period_ns = self._clock.follow_reports(), round(1e9 / self._rate())
        half_ns = (2 * period_ns + DELIVERY_NS) // 2
        self._facts = CameraFacts(
            kind=KIND,
            # A measured stamp accuracy holds for one timing method, so the model's name says which.
            model=(
                f"{self._connection.server or 'IP camera'},"
                f" timed by {'sender reports' if follows else 'arrival'}"
            )[:200],
            width=picture.width,
            height=picture.height,
            pixel_format=self._connection.stream.codec.upper().replace("HEVC", "H265"),
            period_ns=period_ns,
            timestamp_source=TimestampSource.UNKNOWN,
            phase_control=PhaseControl.NONE,
            stamp=None
            if follows
            else StampAccuracy(bias_ns=half_ns, uncertainty_ns=half_ns, source=StampSource.ASSUMED),
        )
        self._last_ns = media_ns
        self._begun.set_result(None)

    def _rate(self) -> float:
        """Return frames per second: requested or stated if the stream confirms it, else measured."""
        step_ns = median(after - before for before, after in pairwise(self._begun_with))
        if step_ns <= 0:
            raise CameraError(
                "gives all its pictures the same time",
                hint="choose another stream of this camera, or a fixed frame rate in its settings",
            )
        seen = 1e9 / step_ns
        nominal = (self._asked_fps or self._connection.stream.fps, round(seen))
        return next((fps for fps in nominal if fps and abs(seen / fps - 1) <= RATE_FRACTION), seen)

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


def load_av() -> Any:
    """Import and return PyAV. Raises NotAvailableError if it is not installed."""
    return load_optional("av", EXTRA, "an IP camera")


def open_camera(address: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> Camera:
    """Create an IP camera from the address after `rtsp:`; it is connected when it is started.

    Raises BadInputError for an address or an option that cannot be read, NotAvailableError without PyAV.
    """
    fps, allows_basic = read_request(options, "an IP camera").fps, options.get("basic") == "yes"
    load_av().logging.set_level(None)
    return RtspCamera(reveal_password(f"{KIND}:{address}"), fps, allows_basic=allows_basic).in_clock(clock)


def list_cameras() -> list[CameraListing]:
    """Return none: IP cameras are named by their addresses."""
    return []
