"""A stand-in for a phone with libsoftwaresync, written from its public source, with all that it lacks.

It has one offset and no skew, one trigger at a time and the first frame at or after it, a phase alignment of
five tries by the constants of a Pixel 3, and no acknowledgement (google-research/libsoftwaresync:
SoftwareSyncClient, SntpListener, CameraController, PhaseAlignController, PhaseConfig, PhaseResponse).
"""

import random
import struct
from dataclasses import dataclass

from capture_app.common.camera_facts import PhaseControl
from capture_app.common.clock import NodeClock
from capture_app.plugins.cameras.sim.profiles import SensorProfile
from capture_app.plugins.cameras.sim.sensor import Sensor

CALL_PORT, TIME_PORT = 8244, 9428
HEARTBEAT, ACK, OFFSET, TRIGGER, ALIGN = 1, 2, 3, 200_000, 200_001
PERIOD_NS, GOAL_NS, ALIGNED_NS = 33_320_000, 15_000_000, 100_000
OVERHEAD_NS, MIN_EXPOSURE_NS, TRIES, TRY_EVERY_NS = 200_000, 33_370_000, 5, 400_000_000
HEARTBEAT_EVERY_NS, ACK_FRESH_NS, OFFSET_FRESH_NS = 1_000_000_000, 2_000_000_000, 3600_000_000_000
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
    """A phone; `now_ns` is by its own clock, which turns its sensor's true times into those."""

    def __init__(
        self,
        name: str,
        host: str,
        now_ns: int,
        rng: random.Random,
        clock: NodeClock,
        *,
        sensor_ppm: float = 0.0,
    ) -> None:
        """`host` is the address that it tells; its frames are too far apart by `sensor_ppm`, in true time."""
        self.name, self.clock, self._host = name, clock, host
        self.offset_ns = self.offsets = self.alignments = 0
        """Leader time is its own time minus the first; and how often it was told that, and to align."""
        self.pictures: list[AppPicture] = []
        self._acked_ns = self._offset_told_ns = -OFFSET_FRESH_NS
        self._beat_due_ns = self._try_due_ns = now_ns
        self._trigger_ns: int | None = None
        self._tries_left = 0
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

    def phase_error_ns(self) -> int:
        """How far the newest frame is from the app's goal, by its own account."""
        return PERIOD_NS if self._phase_ns is None else self._phase_ns - GOAL_NS

    def receive(self, data: bytes, now_ns: int) -> bytes | None:
        """Take in a datagram of either port, and return the answer to one that asks for the time."""
        if len(data) == 8:
            return data + struct.pack(">qq", now_ns, now_ns)
        method, text = struct.unpack_from(">i", data)[0], data[4:].decode()
        if method == ACK:
            self._acked_ns = now_ns
        elif method == OFFSET:
            self.offset_ns, self._offset_told_ns = int(text), now_ns
            self.offsets += 1
        elif method == TRIGGER:
            self._trigger_ns = int(text)
        elif method == ALIGN and not self._tries_left:
            self._tries_left, self._try_due_ns = TRIES, now_ns
            self.alignments += 1
        return None

    def handle_timer(self, now_ns: int) -> bytes | None:
        """Take frames and align; return the heartbeat that is due."""
        while self.clock.local_from_true(self._frame.readout_end_true_ns) <= now_ns:
            self._take_frame()
        if self._tries_left and now_ns >= self._try_due_ns and self._phase_ns is not None:
            self._try_to_align(now_ns, self._phase_ns)
        if now_ns < self._beat_due_ns:
            return None
        self._beat_due_ns += HEARTBEAT_EVERY_NS
        text = f"{self.name},{self._host},{'true' if self.is_synced(now_ns) else 'false'}"
        return struct.pack(">i", HEARTBEAT) + text.encode()

    def _take_frame(self) -> None:
        frame, self._frame = self._frame, self._sensor.next_frame()
        local_ns = self.clock.local_from_true(frame.timestamp_true_ns)
        leader_ns = self.leader_from_local(local_ns)
        self._phase_ns = leader_ns % PERIOD_NS
        if self._trigger_ns is not None and leader_ns >= self._trigger_ns:
            self.pictures.append(AppPicture(leader_ns, local_ns, frame.start_true_ns))
            self._trigger_ns = None

    def _try_to_align(self, now_ns: int, phase_ns: int) -> None:
        late_ns = GOAL_NS - phase_ns
        if abs(late_ns) < ALIGNED_NS:
            self._tries_left = 0
            return
        exposure_ns = max(MIN_EXPOSURE_NS, PERIOD_NS + late_ns % PERIOD_NS // 2 - OVERHEAD_NS)
        self._sensor.inject(exposure_ns, self.clock.true_from_local(now_ns))
        self._tries_left -= 1
        self._try_due_ns = now_ns + TRY_EVERY_NS
