"""GigE Vision and USB3 Vision cameras: listed, opened, and streamed by one thread.

A worker runs all other calls in order.

Its timestamps come from its own counter and are converted to this machine's monotonic clock; all in ns.
"""

import contextlib
import functools
import logging
import threading
from collections import deque
from collections.abc import Callable, Mapping

from msgspec.structs import replace

from capture_app.cameras.arrival_clock import ArrivalClock
from capture_app.cameras.base import Camera, DeviceClock, OnFailure, OnFrame, ThreadedCamera
from capture_app.cameras.frames import CapturedFrame
from capture_app.cameras.specs import read_request
from capture_app.common import system
from capture_app.common.camera_facts import (
    CameraFacts,
    CameraListing,
    Control,
    ControlState,
    StampAccuracy,
    StampSource,
    TimestampSource,
)
from capture_app.common.clock import NodeClock
from capture_app.common.errors import CameraError, NotAvailableError
from capture_app.plugins.cameras.aravis.aravis_device import (
    KIND,
    PACKAGE,
    AravisDevice,
    DeviceFrame,
    load_aravis,
    machine_picture,
)
from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.wire.camera_commands import CameraCommand, SetFrameDuration

FIRST_READINGS, READING_NS = 16, 1_000_000_000
"""Number of counter readings before the stream starts, and the interval between later ones."""
SETTLING_NS, SOON_NS = 3_000_000_000, 100_000_000
"""Duration for which the counter is read at the shorter interval, until its rate is known."""
FIRST_FRAME_NS, SILENCE_NS, MAX_WAIT_NS = 5_000_000_000, 3_000_000_000, 200_000_000
NEAR_NS = 2_000_000_000
"""If the readings map a stamp this far from its frame's arrival, the stamp is not of that counter."""
LATE_NS = 5_000_000
"""Delay after a frame is due, at which its end is assumed."""
SPEC = f"{KIND}:ADDRESS[,key=value…]"
HELP = "GigE Vision and USB3 Vision cameras, by their IP address or serial number."
NEEDS = f"the aravis library: sudo apt install {PACKAGE}"
OPTIONS = {
    "width": "pixels of the picture, out of the middle of the sensor",
    "height": "the same",
    "fps": "frames a second (30)",
    "exposure_us": "exposure, else what the camera has set",
    "format": "pixel format by GenICam's name, such as Mono8 or BayerRG8",
    "row_us": "step that the camera rounds a frame's duration to, where it is coarser than a microsecond",
}


class LatchedClock:
    """Clock of a counter that can be read: each reading falls between a request and its answer.

    The sync engine's clock filter fits the readings, like time messages between two machines.
    """

    def __init__(self) -> None:
        self._filter = ClockFilter()
        self._map: TimeMap | None = None

    def add_reading(self, sent_ns: int, counter_ns: int, answered_ns: int) -> None:
        """Add a counter reading that was taken between two host times."""
        self._filter.add(ClockSample(sent_ns, counter_ns, counter_ns, answered_ns))
        self._map = self._filter.time_map(answered_ns)

    def host_ns(self, counter_ns: int) -> int | None:
        """Return the host's time of a counter reading; None before the first reading."""
        return None if self._map is None else self._map.local_from_leader(counter_ns)

    def accuracy(self, host_ns: int) -> DeviceClock:
        """Return the accuracy of a host time by the readings, of which there is at least one."""
        assert self._map is not None
        uncertainty_ns, bound_ns = self._map.uncertainty_at(host_ns), self._map.hard_bound_at(host_ns)
        return DeviceClock(uncertainty_ns=round(uncertainty_ns), hard_bound_ns=round(bound_ns))


def frames_between(last: int, number: int) -> int:
    """Return the frames from one of the transport's numbers to another; negative for one out of order.

    In GigE Vision 1, numbers have 16 bits and leave out 0.
    """
    return number - last + 65_535 * (last <= 65_535 and number - last < -32_768)


_log = logging.getLogger(__name__)


class AravisCamera(ThreadedCamera):
    """A machine-vision camera, connected when it is started: a missing one takes seconds to notice."""

    def __init__(self, connect: Callable[[], AravisDevice], *, silence_ns: int = SILENCE_NS) -> None:
        """Create the camera; a stream without a frame for `silence_ns` and three periods has failed."""
        super().__init__(KIND)
        self._connect = connect
        self._silence_ns = silence_ns
        self._fetching: threading.Thread | None = None
        self._device: AravisDevice
        self._readings: LatchedClock | None = None
        """Clock of a counter that can be read."""
        self._arrivals: ArrivalClock | None = None
        """Clock of one that cannot; without either, frames are stamped by their arrival."""
        self._target_ns: deque[int] = deque()
        """Requested durations, each for one coming frame, that are not yet sent to the camera."""
        self._requested_ns: deque[int] = deque(maxlen=1)
        """Newest duration for the worker to send: one that it has not begun to send is out of date."""
        self._restore_at_ns: int | None = None
        self._last_number: int | None = None
        self._sequence = 0

    @property
    def device_clock(self) -> DeviceClock | None:
        """Accuracy of the camera's counter against the host's clock; None if it cannot be read."""
        return None if self._readings is None else self._readings.accuracy(system.monotonic_ns())

    async def controls(self) -> tuple[ControlState, ...]:
        """Return the current exposure and gain. Raises CameraError."""
        return await self._in_worker(self._connected.controls)

    async def set_control(self, control: Control, value: float | None) -> None:
        """Set exposure (µs) or gain to a fixed value; None lets the camera choose. Raises CameraError."""
        await self._in_worker(self._connected.set_control, control, value)
        self._facts = self._facts_of(self._device.facts)

    @property
    def _connected(self) -> AravisDevice:
        if not hasattr(self, "_device") or self._closing.is_set():
            raise CameraError(
                "the camera is not connected",
                hint="check its power and cable; capture-app status shows when it is back",
            )
        return self._device

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Connect and stream. Raises CameraError if it is missing, busy, refuses or sends no frames."""
        self.listen(on_frame, on_failure)
        await self._in_worker(self._open)
        self._fetching = threading.Thread(target=self._fetch, name="aravis-frames", daemon=True)
        self._fetching.start()

    async def apply(self, command: CameraCommand) -> None:
        """Set the time from the next frame to the one after it, once; the exposure is unchanged.

        Raises CameraError for other commands, or if the camera does not stream.
        """
        if not isinstance(command, SetFrameDuration):
            raise CameraError("a machine-vision camera is moved by the duration of its frames only")
        if self._fetching is None or self._closing.is_set():
            raise CameraError("the camera does not stream")
        self._target_ns.append(command.duration_ns)

    async def _let_go(self) -> None:
        if self._fetching is not None:
            await self._in_worker(self._fetching.join)
        await self._in_worker(self._release)

    def _open(self) -> None:
        device, latched = self._connect(), LatchedClock()
        self._device = device
        readings = [reading for _ in range(FIRST_READINGS) if (reading := device.read_counter()) is not None]
        for reading in readings:
            latched.add_reading(*reading)
        device.start(lambda: self._call_in_loop(self._lose, f"{device.address} is not controlled any more"))
        first, second = self._first_frame(device), self._first_frame(device)
        is_counting = len({counter_ns for _, counter_ns, _ in readings}) > 1
        # The first stamp may not be valid yet.
        by_latch_ns = latched.host_ns(second.counter_ns) if is_counting else None
        if by_latch_ns is not None and abs(by_latch_ns - second.arrival_ns) < NEAR_NS:
            self._readings = latched
        elif second.counter_ns != first.counter_ns:
            self._arrivals = ArrivalClock()
        self._facts = self._facts_of(device.facts)

    def _first_frame(self, device: AravisDevice) -> DeviceFrame:
        end_ns = system.monotonic_ns() + FIRST_FRAME_NS
        while (left_ns := end_ns - system.monotonic_ns()) > 0 and not self._closing.is_set():
            frame = device.next_frame(left_ns / 1e9)
            if frame is not None and frame.data is not None:
                return frame
        raise CameraError(
            f"{device.address} is there but sends no whole picture",
            hint="run capture-app doctor for the firewall, or give a smaller width=, height= or exposure_us=",
        )

    def _facts_of(self, facts: CameraFacts) -> CameraFacts:
        """Add to the facts which moment of a frame the timestamps mark, if the device's clock can be read."""
        if self._readings is None:
            return facts
        # GenICam's SFNC stamps a frame at its start; some cameras stamp the end of its exposure.
        error_ns = facts.period_ns if facts.exposure_ns is None else facts.exposure_ns
        return replace(
            facts,
            timestamp_source=TimestampSource.START_OF_EXPOSURE,
            stamp=StampAccuracy(
                bias_ns=0, uncertainty_ns=error_ns, source=StampSource.PROFILE, exposure_ns=facts.exposure_ns
            ),
        )

    def _fetch(self) -> None:
        """Fetch frames until the camera is stopped or fails; set frame durations as frames arrive."""
        period_ns = self.facts.period_ns
        begun_ns = heard_ns = read_ns = fresh_ns = system.monotonic_ns()
        while not self._closing.is_set():
            left_ns = (
                period_ns if self._restore_at_ns is None else self._restore_at_ns - system.monotonic_ns()
            )
            frame = self._device.next_frame(min(max(left_ns, 0), MAX_WAIT_NS) / 1e9)
            now_ns = system.monotonic_ns()
            if frame is not None:
                heard_ns = now_ns
                self._take(frame)
            elif now_ns - heard_ns > self._silence_ns + 3 * period_ns:
                self._call_in_loop(self._lose, f"{self._device.address} sends no pictures any more")
                return
            # Only fresh frames time a change. An incomplete frame is delivered only when the next one begins.
            # Of frames that queued up while this thread was delayed, only the first counts.
            fresh = frame is not None and frame.data is not None and now_ns - fresh_ns > period_ns // 2
            fresh_ns = now_ns if fresh else fresh_ns
            self._change_duration(now_ns, fresh=fresh)
            poll_interval_ns = READING_NS if now_ns - begun_ns > SETTLING_NS else SOON_NS
            if now_ns - read_ns >= poll_interval_ns and self._readings is not None:
                read_ns = now_ns
                self._say(self._read_counter, self._readings)

    def _take(self, frame: DeviceFrame) -> None:
        step = 0 if self._last_number is None else frames_between(self._last_number, frame.number)
        if step <= 0 and self._last_number is not None:
            return  # it is out of order
        self._last_number = frame.number
        self._sequence += step
        if frame.data is None:
            return  # its number is missing from the stream, as with any dropped frame
        stamp_ns = self._stamp_ns(frame)
        if stamp_ns is None or abs(stamp_ns - frame.arrival_ns) > NEAR_NS:
            _log.debug("frame %d has a stamp of another time", frame.number)
            return
        facts, readings = self.facts, self._readings
        captured = CapturedFrame(
            sequence=self._sequence,
            stream=0,
            timestamp_ns=stamp_ns,
            picture=machine_picture(frame.data, (facts.width, facts.height), facts.pixel_format),
            exposure_ns=facts.exposure_ns,
            clock_uncertainty_ns=0 if readings is None else readings.accuracy(stamp_ns).uncertainty_ns,
        )
        self._call_in_loop(self._deliver, captured)

    def _stamp_ns(self, frame: DeviceFrame) -> int | None:
        """Return the host's time of a frame, by arrivals late by their minimum delay; None while unknown."""
        if self._arrivals is not None:
            self._arrivals.add_arrival(frame.counter_ns, frame.arrival_ns)
        clock = self._readings or self._arrivals
        return frame.arrival_ns if clock is None else clock.host_ns(frame.counter_ns)

    def _change_duration(self, now_ns: int, *, fresh: bool) -> None:
        """Set the requested duration when a frame has come, and restore the period when the next one has.

        So exactly one frame changes, whether a camera applies a new duration at once or from the next frame.
        If the next frame is lost in transit, the time at which it was due is used instead.
        """
        period_ns, restore_at_ns = self.facts.period_ns, self._restore_at_ns
        if fresh and self._target_ns:
            target_ns = self._target_ns.popleft()
            self._restore_at_ns = now_ns + max(period_ns, target_ns) + LATE_NS
            self._send_duration(target_ns)
        elif restore_at_ns is not None and (fresh or now_ns >= restore_at_ns):
            self._restore_at_ns = None
            self._send_duration(period_ns)

    def _send_duration(self, duration_ns: int) -> None:
        """Let the worker send a duration; it waits for half a second where the camera's answer is lost."""
        self._requested_ns.append(duration_ns)
        self._say(self._set_period)

    def _set_period(self) -> None:
        try:
            period_ns = self._requested_ns.pop()
        except IndexError:
            return  # a newer one was sent in its place
        for _ in range(3):
            try:
                self._device.set_period(period_ns)
                return
            except CameraError as error:
                failure = error
        self._call_in_loop(self._lose, str(failure))

    def _read_counter(self, clock: LatchedClock) -> None:
        with contextlib.suppress(CameraError):  # the heartbeat detects a lost camera
            if (reading := self._device.read_counter()) is not None:
                clock.add_reading(*reading)

    def _say(self, command: Callable[..., None], *arguments: object) -> None:
        with contextlib.suppress(RuntimeError):  # the worker was shut down
            self._worker.submit(command, *arguments)

    def _release(self) -> None:
        if hasattr(self, "_device"):
            self._device.close()

    def _lose(self, what: str) -> None:
        if not self._closing.is_set():
            self._on_failure(CameraError(what, hint="it is tried again; check its power and cable"))


def open_camera(address: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> Camera:
    """Create a camera from its address (IP, serial number, or its listed name); see OPTIONS.

    It is connected when it is started. Raises BadInputError for an option that cannot be read,
    NotAvailableError without the aravis library.
    """
    request = read_request(options, "a machine-vision camera")
    load_aravis()
    return AravisCamera(functools.partial(AravisDevice, address, request)).in_clock(clock)


def list_cameras() -> list[CameraListing]:
    """Return the cameras that answer on this machine's networks and USB; takes a second."""
    try:
        library = load_aravis()
    except NotAvailableError:
        return []
    library.update_device_list()
    listed = []
    for index in range(library.get_n_devices()):
        protocol, address = library.get_device_protocol(index), library.get_device_address(index)
        name = address if protocol == "GigEVision" and address else library.get_device_id(index)
        listed.append(
            CameraListing(
                spec=f"{KIND}:{name}",
                kind=KIND,
                model=f"{library.get_device_vendor(index)} {library.get_device_model(index)}",
                detail=f"{protocol.replace('Vision', ' Vision')},"
                f" serial number {library.get_device_serial_nbr(index)}",
            )
        )
    return listed
