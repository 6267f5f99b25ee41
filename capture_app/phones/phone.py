"""One phone across all connections of its page: its clock, its frames, and requests for its images."""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from math import hypot

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
from capture_app.common.timeouts import PHONE_IMAGE_TIMEOUT_S
from capture_app.phones import wire
from capture_app.phones.frame_times import FrameTimes, TimedFrame
from capture_app.phones.wire import Ping
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


class PhoneClock:
    """Estimates the gateway's monotonic time from the page's; times in ns unless named `_us`."""

    def __init__(self, resolution_us: float) -> None:
        """Create the clock; `resolution_us` is the step of the page's clock, which rounds down."""
        self._step_ns = round(resolution_us * 1000)
        self._filter = ClockFilter()
        self._pending: dict[int, tuple[int, int, int]] = {}
        self._map: TimeMap | None = None
        self._mapped_ns = 0

    @property
    def samples(self) -> int:
        """Number of exchanges so far."""
        return self._filter.samples

    @property
    def is_known(self) -> bool:
        """Whether enough exchanges have arrived to convert times."""
        return self._map is not None

    def note_ping(self, ping: Ping, received_ns: int) -> None:
        """Add the exchange that a ping completes; `received_ns` is its arrival by the gateway's clock."""
        earlier = self._pending.pop(ping.answered, None) if ping.answered is not None else None
        if earlier is None:
            return
        t0_ns, t1_ns, t2_ns = earlier
        # An arrival at the end of a step is reported as its beginning: later is safe, earlier is not.
        t3_ns = round(ping.received_us * 1000) + self._step_ns
        self._filter.add(ClockSample(t0_ns, t1_ns, t2_ns, t3_ns))
        if self.samples >= MIN_SAMPLES and (
            self._map is None or received_ns - self._mapped_ns >= MAPPED_EVERY_NS
        ):
            self._mapped_ns = received_ns
            self._map = self._filter.time_map(t3_ns)

    def note_pong(self, ping: Ping, received_ns: int, sent_ns: int) -> None:
        """Record that a ping is being answered."""
        self._pending[ping.number] = round(ping.now_us * 1000), received_ns, sent_ns
        if len(self._pending) > PENDING:
            del self._pending[next(iter(self._pending))]

    def gateway_ns(self, page_us: float) -> int:
        """Convert a page time in us to the gateway's time; the clock must be known."""
        assert self._map is not None
        return self._map.leader_from_local(round(page_us * 1000))

    def page_us(self, gateway_ns: int) -> float:
        """Convert a gateway time to the page's time in us; the clock must be known."""
        assert self._map is not None
        return self._map.local_from_leader(gateway_ns) / 1000

    def uncertainty_ns(self, page_us: float) -> int:
        """Return the 95 % error of `gateway_ns`, in ns."""
        assert self._map is not None
        known_ns = hypot(self._map.uncertainty_at(round(page_us * 1000)), BROWSER_NS)
        return min(round(known_ns), self.hard_bound_ns(page_us))

    def hard_bound_ns(self, page_us: float) -> int:
        """Return the bound on the error of `gateway_ns`, in ns."""
        assert self._map is not None
        return round(self._map.hard_bound_at(round(page_us * 1000)))

    @property
    def accuracy(self) -> DeviceClock | None:
        """Current accuracy of the page's clock; None while it is unknown."""
        if self._map is None:
            return None
        page_us = self._map.epoch_local_ns / 1000
        return DeviceClock(self.uncertainty_ns(page_us), self.hard_bound_ns(page_us))


_log = logging.getLogger(__name__)

Send = Callable[[str | bytes], Awaitable[None]]
OnFrame = Callable[[TimedFrame], None]


class Phone:
    """A phone that was admitted; `link_opened` and `link_closed` report its page's connection."""

    def __init__(self, name: str, now_ns: Callable[[], int], hello: wire.Hello) -> None:
        """Create a phone; `now_ns` is the gateway's monotonic clock, `hello` its first page's hello."""
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
        self._last_order = 0
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
        self._last_order += 1
        number = self._last_order
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
        picture = self._pictures.get(key)
        if picture is None:
            picture = self._pictures[key] = asyncio.get_running_loop().create_future()
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
                    closed = asyncio.ensure_future(self.closed.wait())
                    await asyncio.wait((picture, closed), return_when=asyncio.FIRST_COMPLETED)
                    closed.cancel()
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

    # Methods for the link

    def link_opened(self, send: Send, hello: wire.Hello) -> None:
        """Connect a page of this phone, and wake the requests for images, which are then sent again.

        If the page was loaded again, the phone's clock starts anew.
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
        if isinstance(message, wire.PageHidden):
            self._stand_still(message.why)
            return
        if isinstance(message, wire.Controls):
            self.controls = message.controls
            answered = self._orders.pop(message.answers or 0, None)
            if answered is not None and not answered.done():
                answered.set_result(message.problem)
            return
        before = self._opened
        if before is not None and (before.width, before.height) != (message.width, message.height):
            # From now on its images count as another camera's.
            self._stand_still("it was rotated, and joins again")
        if before != message:
            self._times = FrameTimes(message.frame_rate)
        self._opened = message

    def take_binary(
        self, message: wire.Ping | wire.FrameReport | wire.PictureBytes, received_ns: int
    ) -> None:
        """Process a binary message of the page: a frame, an image, or a ping that is answered already."""
        match message:
            case wire.Ping():
                self.clock.note_ping(message, received_ns)
            case wire.PictureBytes():
                picture = self._pictures.get((self.page, message.id, message.is_preview))
                if picture is not None and not picture.done():
                    picture.set_result(message.data)
            case wire.FrameReport() if self._opened is not None:
                timed = self._times.add(message)
                if self._times.period_ns is not None and self.clock.is_known:
                    self.came.set()
                for frame in timed:
                    if self._on_frame is not None and self.clock.is_known:
                        self._on_frame(frame)

    def _stand_still(self, why: str) -> None:
        self.came.clear()
        self._opened, self._disconnect_reason = None, why
        if self._on_disconnect is not None:
            self._on_disconnect(why)


def browser_name(user_agent: str) -> str:
    """Return a short name of a browser and its device from the user agent."""
    for sign, name in (
        ("Firefox/", "Firefox"),
        ("Edg", "Edge"),
        ("Chrome/", "Chrome"),
        ("Safari/", "Safari"),
    ):
        if sign in user_agent:
            for device in ("iPhone", "iPad", "Android", "Linux", "Windows", "Macintosh"):
                if device in user_agent:
                    return f"{name} on {device}"
            return name
    return "browser"
