"""One phone across all connections of its page: its clock, its frames, and requests for its images."""

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from itertools import count
from math import hypot
from statistics import median

from capture_app.cameras.base import DeviceClock
from capture_app.common.camera_facts import (
    PHONE,
    CameraFacts,
    Control,
    ControlState,
    PhaseControl,
    StampAccuracy,
    StampSource,
    TimestampSource,
)
from capture_app.common.errors import CameraError
from capture_app.common.tasks import first_of
from capture_app.common.timeouts import PHONE_IMAGE_TIMEOUT_S
from capture_app.companions.phones import wire
from capture_app.companions.phones.wire import FrameReport, Ping
from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample
from capture_app.sync.clock.time_map import TimeMap

MIN_SAMPLES = 300
MAPPED_EVERY_NS = 500_000_000
PENDING = 64
BROWSER_NS = 60_000.0
"""95 % bound of the asymmetry that a browser adds between its clock and the socket; no exchange shows it.
Headless Chromium over a loopback: see docs/accuracy-measurements.md.
"""
ORDER_S = 10.0
MAX_EXPOSURE_US = 1e7
DELIVERY_NS = 100_000_000
"""Max delay from a frame's readout to its arrival at a page; assumed, as no browser reports it."""
NEVER = "its page is closed: open it again on the phone"
STARTING = "its camera is starting, or its clock is being measured"
BLOCK_US, BLOCKS = 3e6, 10
STALE_NS, SILENT_NS = 1_000_000_000, 8_000_000_000
"""Age at which a frame is of no use to a burst, and the time without one after which its user is informed."""
HELD_FRAMES = 8
"""Number of first frames held back; their minimum delay locates the zero of the stream's media times."""
RATE_FRAMES, RATE_FRACTION = 20, 0.05
"""Number of frames by which a browser's stated rate is checked, and the relative tolerance."""
TYPICAL_RATE = 30.0
MIN_RATE, MAX_RATE = 1.0, 1000.0


class PhoneClock:
    """Estimates the gateway's host time from the page's; times in ns unless named `_us`."""

    def __init__(self, resolution_us: float) -> None:
        """Create the clock; `resolution_us` is the step of the page's clock, which rounds down."""
        self._step_ns = round(resolution_us * 1000)
        self._filter = ClockFilter()
        self._pending: dict[int, tuple[int, int, int]] = {}
        self._map: TimeMap
        self.is_known = False
        """Whether enough exchanges have arrived to convert times."""
        self._mapped_ns = 0

    @property
    def samples(self) -> int:
        """Number of exchanges so far."""
        return self._filter.samples

    def note_ping(self, ping: Ping, received_ns: int) -> None:
        """Add the exchange that a ping completes; `received_ns` is its arrival by the gateway's clock."""
        if ping.answered not in self._pending:
            return
        t0_ns, t1_ns, t2_ns = self._pending.pop(ping.answered)
        # An arrival at the end of a step is reported as its beginning: later is safe, earlier is not.
        t3_ns = round(ping.received_us * 1000) + self._step_ns
        self._filter.add(ClockSample(t0_ns, t1_ns, t2_ns, t3_ns))
        is_due = not self.is_known or received_ns - self._mapped_ns >= MAPPED_EVERY_NS
        if self.samples >= MIN_SAMPLES and is_due:
            self._mapped_ns = received_ns
            if (known := self._filter.time_map(t3_ns)) is not None:
                self._map, self.is_known = known, True

    def note_pong(self, ping: Ping, received_ns: int, sent_ns: int) -> None:
        """Record that a ping is being answered."""
        self._pending[ping.number] = round(ping.now_us * 1000), received_ns, sent_ns
        if len(self._pending) > PENDING:
            del self._pending[next(iter(self._pending))]

    def gateway_ns(self, page_us: float) -> int:
        """Convert a page time in us to the gateway's time; the clock must be known."""
        return self._map.leader_from_local(round(page_us * 1000))

    def page_us(self, gateway_ns: int) -> float:
        """Convert a gateway time to the page's time in us; the clock must be known."""
        return self._map.local_from_leader(gateway_ns) / 1000

    def uncertainty_ns(self, page_us: float) -> int:
        """Return the 95 % error of `gateway_ns`, in ns."""
        known_ns = hypot(self._map.uncertainty_at(round(page_us * 1000)), BROWSER_NS)
        return min(round(known_ns), self.hard_bound_ns(page_us))

    def hard_bound_ns(self, page_us: float) -> int:
        """Return the bound on the error of `gateway_ns`, in ns."""
        return round(self._map.hard_bound_at(round(page_us * 1000)))

    @property
    def accuracy(self) -> DeviceClock | None:
        """Current accuracy of the page's clock; None while it is unknown."""
        if not self.is_known:
            return None
        page_us = self._map.epoch_local_ns / 1000
        return DeviceClock(self.uncertainty_ns(page_us), self.hard_bound_ns(page_us))


@dataclass(frozen=True, slots=True)
class PhoneFrame:
    """A frame with its number in its stream, counting gaps, and its time in the page's clock in us."""

    id: int
    stream: int
    sequence: int
    page_us: float


class FrameTimes:
    """Converts a page's frame reports to numbered, timed frames, one stream after another."""

    def __init__(self, rate: float) -> None:
        """Create the converter; `rate` in frames/s is the browser's setting, 0 if it states none."""
        self._rate = rate
        self._stream: int | None = None
        self._arrivals: deque[tuple[float, float]] = deque(maxlen=BLOCKS)
        """Start of a time block, and its minimum offset of the page's clock from media time, in us."""
        self._held: list[FrameReport] | None = []
        """First frames of the stream; None once they are passed on."""
        self._sequence, self._last_us = 0, 0.0
        self._steps_us: list[float] = []
        self.period_ns: int | None = None
        """Measured period of the camera; None until enough frames have arrived."""

    def add(self, report: FrameReport) -> list[PhoneFrame]:
        """Add a frame; return the frames that can be timed now, none while a stream begins."""
        if report.stream != self._stream:
            self._stream = report.stream
            self._arrivals.clear()
            self._held, self._sequence = [], 0
        self._note_arrival(report.media_us, report.capture_us or report.arrived_us)
        if self.period_ns is None:
            self._measure_rate(report)
        if self._held is None:
            return [self._timed(report, first=False)]
        self._held.append(report)
        if self.period_ns is None or len(self._held) < HELD_FRAMES:
            return []
        held, self._held = self._held, None
        return [self._timed(frame, first=n == 0) for n, frame in enumerate(held)]

    def _note_arrival(self, media_us: float, seen_us: float) -> None:
        offset_us = seen_us - media_us
        if not self._arrivals or seen_us - self._arrivals[-1][0] >= BLOCK_US:
            self._arrivals.append((seen_us, offset_us))
        elif offset_us < self._arrivals[-1][1]:
            self._arrivals[-1] = self._arrivals[-1][0], offset_us

    def _measure_rate(self, report: FrameReport) -> None:
        if self._held:
            self._steps_us.append(report.media_us - self._held[-1].media_us)
        if len(self._steps_us) >= RATE_FRAMES:
            step_us, rate = median(self._steps_us), self._rate or TYPICAL_RATE
            if step_us > 0 and abs(step_us * rate / 1e6 - 1) > RATE_FRACTION:
                rate = round(1e6 / max(step_us, 1e6 / MAX_RATE))
            self.period_ns = round(1e9 / min(max(rate, MIN_RATE), MAX_RATE))

    def _timed(self, report: FrameReport, *, first: bool) -> PhoneFrame:
        assert self.period_ns is not None
        if not first:
            self._sequence += max(1, round((report.media_us - self._last_us) * 1000 / self.period_ns))
        self._last_us = report.media_us
        # The minimum delay of the last half minute, when everything was fast, locates the media times' zero.
        # The delay of camera and phone before that is not known here, and is part of the bias of the stamps.
        offset_us = min(offset_us for _, offset_us in self._arrivals)
        return PhoneFrame(report.id, report.stream, self._sequence, report.media_us + offset_us)


Send = Callable[[str | bytes], Awaitable[None]]
OnFrame = Callable[[PhoneFrame], None]


class Phone:
    """A phone that was admitted; `link_opened` and `link_closed` report its page's connection."""

    def __init__(self, name: str, now_ns: Callable[[], int], hello: wire.PhoneHello) -> None:
        """Create a phone; `now_ns` is the clock of the gateway's host, `hello` its first page's hello."""
        self.name = name
        self.came = asyncio.Event()
        """Set while its camera streams and its clock is known."""
        self.closed = asyncio.Event()
        """Set while none of its pages is connected."""
        self.closed.set()
        self.back = asyncio.Event()
        """Set while one of its pages is connected."""
        self.said_goodbye = False
        """Whether the phone's user left, or the leader's user removed the phone."""
        self.put_off: Callable[[], None] = lambda: None
        """Closes its page's link, and refuses it until it uses a new code."""
        self.on_sound: Callable[[bytes, int], object] = lambda pcm, arrival_ns: None
        """Takes samples of its microphone, and their arrival at the page in ns of the gateway's clock."""
        self._now_ns = now_ns
        self._send: Send | None = None
        self._hello, self.page = hello, hello.page
        """Id of the page load whose frames the phone stores."""
        self.clock = PhoneClock(hello.resolution_us)
        """Estimate of the clock of the phone's page."""
        self._opened: wire.Opened | None = None
        self._disconnect_reason = NEVER
        self._times = FrameTimes(0.0)
        self._pictures: dict[tuple[str, int, bool], asyncio.Future[bytes]] = {}
        self.controls: tuple[ControlState, ...] = ()
        """The camera's controls, as the page last reported them."""
        self._orders: dict[int, asyncio.Future[str]] = {}
        self._numbers = count(1)
        self._usable_ns = now_ns()
        self._on_frame: OnFrame | None = None
        self._on_disconnect: Callable[[str], None] | None = None

    @property
    def facts(self) -> CameraFacts:
        """Facts of the phone's camera. Raises CameraError while it does not stream."""
        opened, period_ns = self._opened, self._times.period_ns
        if opened is None or period_ns is None or not self.clock.is_known:
            raise CameraError(f"{self.name}: {self._disconnect_reason if opened is None else STARTING}")
        # Stamps are fastest arrivals: later than the start by exposure, readout and delivery to the page.
        exposure_ns, browser = self.exposure_ns, browser_name(self._hello.user_agent)
        exposed_ns = period_ns if exposure_ns is None else min(exposure_ns, period_ns)
        half_ns = (exposed_ns + period_ns + DELIVERY_NS) // 2
        return CameraFacts(
            kind=PHONE,
            model=" ".join(filter(None, (self._hello.model or browser, opened.label)))[:200],
            width=opened.width,
            height=opened.height,
            pixel_format="JPEG",
            period_ns=period_ns,
            timestamp_source=TimestampSource.UNKNOWN,
            phase_control=PhaseControl.RESET,
            exposure_ns=exposure_ns,
            stamp=StampAccuracy(bias_ns=half_ns, uncertainty_ns=half_ns, source=StampSource.ASSUMED),
        )

    # Methods for the camera

    def watch(self, on_frame: OnFrame, on_disconnect: Callable[[str], None]) -> None:
        """Pass on all frames from now on, and call `on_disconnect` once when no more will come."""
        self._on_frame, self._on_disconnect = on_frame, on_disconnect

    def unwatch(self) -> None:
        """Stop passing frames on."""
        self._on_frame = self._on_disconnect = None

    async def restart(self, delay_ns: int) -> None:
        """Restart the phone's camera `delay_ns` from now. Raises CameraError if it is not connected."""
        at_us = self.clock.page_us(self._now_ns() + delay_ns)
        if self._send is None or self._opened is None:
            raise CameraError(f"{self.name}: {self._disconnect_reason}")
        await self._send(wire.order("restart", at_us=at_us))

    async def set_control(self, control: Control, value: float | None) -> None:
        """Set a control; None lets the camera choose. Raises CameraError if the page did not set it."""
        if self._send is None:
            raise CameraError(f"{self.name}: {self._disconnect_reason}")
        number = next(self._numbers)
        answered = self._orders[number] = asyncio.get_running_loop().create_future()
        try:
            await self._send(wire.order("control", number=number, control=control, value=value))
            async with asyncio.timeout(ORDER_S):
                problem = await answered
        except TimeoutError:
            raise CameraError(
                f"{self.name} did not answer in {ORDER_S:g} s", hint="keep its page open and its screen on"
            ) from None
        finally:
            self._orders.pop(number, None)
        if problem:
            raise CameraError(
                f"{self.name}: {problem}", hint="capture-app cameras controls shows what this phone can set"
            )

    @property
    def exposure_ns(self) -> int | None:
        """Exposure of the phone's frames, if its browser reports it."""
        exposure_us = self._value(Control.EXPOSURE)
        return None if exposure_us is None else round(min(max(exposure_us, 0.0), MAX_EXPOSURE_US) * 1000)

    @property
    def gain(self) -> float | None:
        """Gain of the phone's frames, 1 for ISO 100, if its browser reports it."""
        return self._value(Control.GAIN)

    def _value(self, control: Control) -> float | None:
        return next((state.value for state in self.controls if state.control is control), None)

    async def report_state(self, state: str, words: str) -> None:
        """Send its page the state of its camera; do nothing if none is connected."""
        if self._send is not None:
            accuracy = self.clock.accuracy
            known = (
                "being measured" if accuracy is None else f"known to ±{accuracy.uncertainty_ns / 1e6:.2f} ms"
            )
            await self._send(wire.order("state", name=self.name, state=state, words=words, clock=known))

    async def fetch(self, page: str, number: int, width: int | None = None) -> bytes:
        """Return a frame's JPEG, or with a width a small one; waits for a broken link to reconnect.

        Raises CameraError if the phone no longer has it, or does not deliver it.
        """
        key = page, number, width is not None
        small = {} if width is None else {"width": width}
        request = wire.order("preview" if small else "picture", id=number, **small)
        picture = self._pictures.setdefault(key, asyncio.get_running_loop().create_future())
        try:
            async with asyncio.timeout(PHONE_IMAGE_TIMEOUT_S):
                while not picture.done():
                    await self.back.wait()
                    if page != self.page:
                        raise CameraError(
                            f"{self.name} no longer has the image: its page was loaded again",
                            hint="do not reload its page before the take is saved",
                        )
                    if self._send is not None:
                        await self._send(request)
                    await first_of(asyncio.wait((picture,)), self.closed.wait())
        except TimeoutError:
            raise CameraError(
                f"{self.name} did not send the image within {PHONE_IMAGE_TIMEOUT_S:g} s",
                hint="keep its page open and its screen on",
            ) from None
        finally:
            self._pictures.pop(key, None)
        if not picture.result():
            raise CameraError(
                f"{self.name} no longer has the image: it was requested too late", hint="take fewer frames"
            )
        return picture.result()

    def check_frames(self) -> None:
        """Raise CameraError if its camera is open, but gave no frame of use for SILENT_NS."""
        if self._opened is not None and self._now_ns() - self._usable_ns > SILENT_NS:
            self.came.clear()
            raise CameraError(
                f"{self.name}: its page delivers no frame that can be used",
                hint="load its page again; if this comes back, use another browser",
            )

    # Methods for the link

    def link_opened(self, send: Send, hello: wire.PhoneHello) -> None:
        """Connect a page of this phone, and wake the requests for images, which are then sent again.

        If the page was loaded again, the phone's clock starts again.
        """
        self._send, self._hello, self.said_goodbye = send, hello, False
        if hello.page != self.page:
            # The clock of another page load has another zero.
            self.page, self.clock = hello.page, PhoneClock(hello.resolution_us)
        self.closed.clear()
        self.back.set()

    def link_closed(self, send: Send, *, by_user: bool) -> None:
        """Disconnect the page; ignored for a page that another has replaced."""
        if self._send is not send:
            return
        self._send, self.said_goodbye = None, self.said_goodbye or by_user
        self.back.clear()
        self.closed.set()
        self._stand_still(NEVER)

    def take_text(self, message: wire.Opened | wire.Controls | wire.PageHidden) -> None:
        """Process the page's report on its camera."""
        match message:
            case wire.PageHidden():
                self._stand_still(message.why)
            case wire.Controls():
                self.controls = message.controls
                answered = self._orders.pop(message.answers or 0, None)
                if answered is not None and not answered.done():
                    answered.set_result(message.problem)
            case wire.Opened():
                before = self._opened
                if before is not None and (before.width, before.height) != (message.width, message.height):
                    # From now on its images count as another camera's.
                    self._stand_still("it was rotated, and joins again")
                if before != message:
                    self._times = FrameTimes(message.frame_rate)
                self._opened = message

    def take_binary(
        self,
        message: wire.Ping | wire.FrameReport | wire.PictureBytes | wire.SoundReport,
        received_ns: int,
    ) -> None:
        """Process a binary message of the page: a frame, an image, sound, or a ping that is answered."""
        match message:
            case wire.Ping():
                self.clock.note_ping(message, received_ns)
            case wire.PictureBytes():
                picture = self._pictures.get((self.page, message.id, message.is_preview))
                if picture is not None and not picture.done():
                    picture.set_result(message.data)
            case wire.SoundReport():
                if self.clock.is_known:
                    self.on_sound(message.pcm, self.clock.gateway_ns(message.arrived_us))
            case wire.FrameReport() if self._opened is not None:
                timed = self._times.add(message) if self.clock.is_known else []
                if timed and received_ns - self.clock.gateway_ns(timed[-1].page_us) < STALE_NS:
                    self._usable_ns = received_ns
                    self.came.set()
                for frame in timed:
                    if self._on_frame is not None:
                        self._on_frame(frame)

    def _stand_still(self, why: str) -> None:
        self.came.clear()
        self._opened, self._disconnect_reason = None, why
        if self._on_disconnect is not None:
            self._on_disconnect(why)


def browser_name(user_agent: str) -> str:
    """Return a short name of a browser and its device from the user agent."""
    signs = {"Firefox/": "Firefox", "Edg": "Edge", "Chrome/": "Chrome", "Safari/": "Safari"}
    name = next((name for sign, name in signs.items() if sign in user_agent), "")
    devices = ("iPhone", "iPad", "Android", "Linux", "Windows", "Macintosh")
    device = next((f" on {device}" for device in devices if device in user_agent), "")
    return name + device if name else "browser"
