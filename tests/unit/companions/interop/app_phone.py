"""A stand-in for a phone with libsoftwaresync or RecSync, from what its protocol is known to do.

It keeps the app's faults: one offset and no skew, one trigger at a time and the first frame at or after it, a
phase alignment of five tries at most by the app's constants, nothing acknowledged.
"""

import random
from dataclasses import dataclass

from capture_app.common.camera_facts import PhaseControl
from capture_app.common.clock import NodeClock
from capture_app.companions.interop.app_protocol import (
    ALIGNED_NS,
    CALL_PORT,
    GOAL_PHASE_NS,
    HEARTBEAT_EVERY_NS,
    PERIOD_NS,
    TIME_ANSWER,
    TIME_PORT,
    TIME_REQUEST,
    CallMethod,
    decode_call,
    encode_call,
)
from capture_app.plugins.cameras.sim.profiles import SensorProfile
from capture_app.plugins.cameras.sim.sensor import Sensor

ACK_FRESH_NS, OFFSET_FRESH_NS = 2_000_000_000, 3600_000_000_000
OVERHEAD_NS, MIN_EXPOSURE_NS, TRIES, TRY_EVERY_NS = 200_000, 33_370_000, 5, 400_000_000
PIXEL = SensorProfile(
    name="pixel-3",
    model="stand-in for a Pixel 3 with libsoftwaresync",
    phase_control=PhaseControl.INJECTION,
    row_time_ns=10_000,
    frame_length_rows=PERIOD_NS // 10_000,
    margin_rows=20,
    injection_gain=2,
    timestamp_noise_ns=3_000,
)
"""Its long frames are held for two, which is what the app's rule of half the shift is made for."""
Address = tuple[str, int]


@dataclass(frozen=True, slots=True)
class AppPicture:
    """A frame that the phone has saved: its start by what it takes for leader time, by its own, and truly."""

    leader_ns: int
    local_ns: int
    true_ns: int


class StandInPhone:
    """A phone; `now_ns` is by its own clock, which turns its sensor's true times into those.

    It has two ports, as the app: `receive_call` and `receive_time` take what comes to them.
    """

    def __init__(
        self,
        name: str,
        host: str,
        leader_host: str,
        now_ns: int,
        rng: random.Random,
        clock: NodeClock,
        *,
        sensor_ppm: float = 0.0,
    ) -> None:
        """`host` is the address that it tells, its own; `leader_host` that of its DHCP server.

        `sensor_ppm` is by how much its frames are too far apart, in true time.
        """
        self.name, self._host, self._leader_host = name, host, leader_host
        self._clock = clock
        self.offset_ns = 0
        """Leader time is its own time minus this."""
        self.offsets = 0
        """How often it was told."""
        self.pictures: list[AppPicture] = []
        self.recordings: list[str] = []
        """start and stop, as they were ordered."""
        self.exposure: tuple[int, int] | None = None
        """Exposure in ns, and ISO, where it was told."""
        self.alignments = 0
        self._acked_ns = self._offset_told_ns = -OFFSET_FRESH_NS
        self._beat_due_ns = now_ns
        self._trigger_ns: int | None = None
        self._tries_left, self._try_due_ns = 0, now_ns
        self._out: list[tuple[bytes, Address]] = []
        self._sensor = Sensor(PIXEL, rng, period_error_ppm=sensor_ppm)
        self._sensor.start(clock.true_from_local(now_ns))
        self._frame = self._sensor.next_frame()
        self._phase_ns: int | None = None

    def is_synced(self, now_ns: int) -> bool:
        """Whether the app calls itself synchronized."""
        return now_ns - self._acked_ns < ACK_FRESH_NS and now_ns - self._offset_told_ns < OFFSET_FRESH_NS

    def leader_from_local(self, local_ns: int) -> int:
        """What the app takes for leader time, in ns."""
        return local_ns - self.offset_ns

    def phase_error_ns(self) -> int | None:
        """How far the newest frame is from the app's goal, by its own account; None before the first."""
        return None if self._phase_ns is None else self._phase_ns - GOAL_PHASE_NS

    def receive_call(self, data: bytes, now_ns: int) -> None:
        """Take in a call."""
        method, text = decode_call(data) or (0, "")
        if method == CallMethod.HEARTBEAT_ACK:
            self._acked_ns = now_ns
        elif method == CallMethod.OFFSET_UPDATE:
            self.offset_ns, self._offset_told_ns = int(text), now_ns
            self.offsets += 1
        elif method == CallMethod.SET_TRIGGER_TIME:
            self._trigger_ns = int(text)
        elif method == CallMethod.DO_PHASE_ALIGN and not self._tries_left:
            self._tries_left, self._try_due_ns = TRIES, now_ns
            self.alignments += 1
        elif method == CallMethod.SET_EXPOSURE:
            exposure_ns, iso = text.split(",")
            self.exposure = int(exposure_ns), int(iso)
        elif method in (CallMethod.START_RECORDING, CallMethod.STOP_RECORDING):
            self.recordings.append("start" if method == CallMethod.START_RECORDING else "stop")

    def receive_time(self, data: bytes, host: str, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return the answer to a time request of `host`, to that host's fixed port; send it at once."""
        if len(data) != TIME_REQUEST.size:
            return []
        (t0_ns,) = TIME_REQUEST.unpack(data)
        return [(TIME_ANSWER.pack(t0_ns, now_ns, now_ns), (host, TIME_PORT))]

    def next_timer(self) -> int:
        """When `handle_timer` wants to be called, by the phone's clock in ns."""
        frame_ns = self._clock.local_from_true(self._frame.readout_end_true_ns)
        return min(self._beat_due_ns, frame_ns, self._try_due_ns if self._tries_left else frame_ns)

    def handle_timer(self, now_ns: int) -> None:
        """Take frames, align, and say that it is here."""
        if now_ns >= self._beat_due_ns:
            self._beat_due_ns = now_ns + HEARTBEAT_EVERY_NS
            text = f"{self.name},{self._host},{'true' if self.is_synced(now_ns) else 'false'}"
            self._out.append((encode_call(CallMethod.HEARTBEAT, text), (self._leader_host, CALL_PORT)))
        while self._clock.local_from_true(self._frame.readout_end_true_ns) <= now_ns:
            self._take_frame()
        if self._tries_left and now_ns >= self._try_due_ns and self._phase_ns is not None:
            self._try_to_align(now_ns, self._phase_ns)

    def calls_to_send(self) -> list[tuple[bytes, Address]]:
        """Return the heartbeats that are due."""
        out, self._out = self._out, []
        return out

    def _take_frame(self) -> None:
        frame, self._frame = self._frame, self._sensor.next_frame()
        local_ns = self._clock.local_from_true(frame.timestamp_true_ns)
        leader_ns = self.leader_from_local(local_ns)
        self._phase_ns = leader_ns % PERIOD_NS
        if self._trigger_ns is not None and leader_ns >= self._trigger_ns:
            self.pictures.append(AppPicture(leader_ns, local_ns, frame.start_true_ns))
            self._trigger_ns = None

    def _try_to_align(self, now_ns: int, phase_ns: int) -> None:
        target_ns = GOAL_PHASE_NS - phase_ns
        if abs(target_ns) < ALIGNED_NS:
            self._tries_left = 0
            return
        shift_ns = target_ns % PERIOD_NS
        exposure_ns = max(MIN_EXPOSURE_NS, PERIOD_NS + shift_ns // 2 - OVERHEAD_NS)
        self._sensor.inject(exposure_ns, self._clock.true_from_local(now_ns))
        self._tries_left -= 1
        self._try_due_ns = now_ns + TRY_EVERY_NS
