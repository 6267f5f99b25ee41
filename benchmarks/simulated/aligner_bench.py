"""One simulated camera and its aligner, frame by frame in stepped time; the clock is known exactly.

For tests without a network: local, leader and true time are equal, except for a clock error that a test adds.
"""

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec

from capture_app.plugins.cameras.sim.profiles import SensorProfile, facts_of
from capture_app.plugins.cameras.sim.sensor import DELIVERY_NS, Sensor, SensorFrame
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.actuators import InjectionProfile
from capture_app.sync.phase.aligner import Aligner
from capture_app.sync.phase.estimator import FrameStamp
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.wire.camera_commands import CameraCommand, InjectFrame, RestartStream, SetFrameDuration

START_NS = 1_000_000_000
"""Interval after zero in which streams start, and grids have their origin."""


@dataclass(frozen=True, slots=True)
class FrameObservation:
    """A frame's true phase error, and the aligner's estimate of it; times in ns."""

    now_ns: int
    error_ns: int
    aligned: bool
    corrections: int


class Bench:
    """A sensor and its aligner; `deliver` delivers one frame and executes what the aligner requests."""

    def __init__(
        self,
        profile: SensorProfile,
        seed: int,
        tolerance_ns: int,
        *,
        ppm: float | None = None,
        row_known: bool = True,
        aimed: bool = True,
        known: InjectionProfile | None = None,
        grid: FrameGrid | None = None,
        clock_noise_ns: int = 0,
        start_latencies_ns: Sequence[int] = (),
    ) -> None:
        """Create the sensor; draws a grid without `grid`, and a crystal without `ppm` (15 ppm, 1 sigma)."""
        rng = random.Random(seed)
        self.profile = profile
        self.sensor = Sensor(profile, rng, period_error_ppm=rng.gauss(0.0, 15.0) if ppm is None else ppm)
        facts = facts_of(profile, width=profile.image_width, height=profile.image_rows)
        camera = facts if row_known else msgspec.structs.replace(facts, row_time_ns=None)
        self.aligner = Aligner(camera, tolerance_ns=tolerance_ns, rng=rng, aimed=aimed, profile=known)
        self.grid = grid or FrameGrid(rng.randrange(START_NS), profile.period_ns)
        self.common_instant_leader_ns: int | None = None
        self.now_ns = 0
        self.commands: list[CameraCommand] = []
        self.dropped = 0
        self._clock_rng, self._clock_noise_ns = random.Random(rng.getrandbits(64)), clock_noise_ns
        self._next: SensorFrame
        for latency_ns in start_latencies_ns:
            self.aligner.learn_start_latency(latency_ns)
        self.start(rng.randrange(START_NS))

    @property
    def due_ns(self) -> int:
        """Return when the next frame is delivered."""
        return self._next.readout_end_true_ns + DELIVERY_NS

    def start(self, at_ns: int) -> None:
        """Start or restart the stream."""
        self.sensor.stop()
        self.sensor.start(at_ns)
        self.aligner.note_stream_start(at_ns)
        self._next = self.sensor.next_frame()

    def next_frame(self) -> SensorFrame:
        """Advance to the next frame, and show it to the aligner unless it was dropped."""
        frame, self.now_ns = self._next, self.due_ns
        self._next = self.sensor.next_frame()
        if frame.dropped:
            self.dropped += frame.sequence > 0
        else:
            self.aligner.add_frame(FrameStamp(frame.sequence, frame.stream, frame.timestamp_true_ns))
        return frame

    def deliver(self, *, hold: bool = False) -> FrameObservation | None:
        """Deliver the next frame at its time; None if it was dropped."""
        frame = self.next_frame()
        return None if frame.dropped else self.step_aligner(frame, hold=hold)

    def step_aligner(
        self, frame: SensorFrame, *, hold: bool = False, burst_ns: tuple[int, int] | None = None
    ) -> FrameObservation:
        """Let the aligner step its stream after that frame, and execute what it requests.

        `burst_ns` are the first and last instant of a burst that is due.
        """
        now_ns = self.now_ns
        offset_ns = round(self._clock_rng.gauss(0.0, self._clock_noise_ns)) if self._clock_noise_ns else 0
        time_map = TimeMap(0, offset_ns, 0.0, 0.0, 0.0, 0.0, 0.0, 300, 1000)
        command = self.aligner.next_command(
            time_map,
            self.grid,
            now_ns,
            hold=hold,
            burst_leader_ns=burst_ns,
            common_instant_leader_ns=self.common_instant_leader_ns,
        )
        error_ns = self.grid.phase_error(frame.start_true_ns)
        observation = FrameObservation(
            now_ns, error_ns, self.aligner.window.aligned, self.aligner.corrections
        )
        if command is not None:
            self.commands.append(command)
            self.apply(command, now_ns)
        return observation

    def apply(self, command: CameraCommand, now_ns: int) -> None:
        """Execute a command on the sensor."""
        match command:
            case InjectFrame(exposure_ns):
                self.sensor.inject(exposure_ns, now_ns)
            case SetFrameDuration(duration_ns):
                self.sensor.set_frame_duration(duration_ns, now_ns)
            case RestartStream(delay_ns):
                self.start(now_ns + delay_ns)

    def run(
        self,
        duration_ns: int,
        *,
        until: Callable[[FrameObservation], bool] = lambda _: False,
        hold: bool = False,
    ) -> list[FrameObservation]:
        """Deliver frames for that duration, or until one fulfils the condition; return the observations."""
        end_ns = self.due_ns + duration_ns
        observations: list[FrameObservation] = []
        while self.due_ns < end_ns and not (observations and until(observations[-1])):
            observation = self.deliver(hold=hold)
            if observation is not None:
                observations.append(observation)
        return observations
