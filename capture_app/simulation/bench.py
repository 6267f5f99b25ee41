"""One simulated camera and its aligner, frame by frame in stepped time; the clock is known exactly.

For what does not need a network: local, leader and true time are the same, save for the clock's error that a
test adds.
"""

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from capture_app.simulation.sensor import Sensor, SensorFrame, SensorProfile
from capture_app.sync.aligner import Aligner
from capture_app.sync.commands import CameraCommand, InjectFrame, RestartStream, SetFrameDuration
from capture_app.sync.injection import InjectionProfile
from capture_app.sync.phase import FrameStamp
from capture_app.sync.timebase import Goal, TimeMap

DELIVERY_NS = 5_000_000
"""From a frame's last row to the driver's callback."""
START_NS = 1_000_000_000
"""Streams start, and goals lie, within this after zero."""


@dataclass(frozen=True, slots=True)
class Look:
    """What one frame looked like: its true error, and what the aligner held of it; times in ns."""

    now_ns: int
    error_ns: int
    aligned: bool
    corrections: int


class Bench:
    """A sensor and its aligner; `deliver` brings one frame and carries out what the aligner asks for."""

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
        goal: Goal | None = None,
        clock_noise_ns: int = 0,
        starts_seen: Sequence[int] = (),
    ) -> None:
        """Without `ppm` a crystal is drawn, with a standard deviation of 15 ppm; without `goal` a goal."""
        rng = random.Random(seed)
        self.profile = profile
        self.sensor = Sensor(profile, rng, period_error_ppm=rng.gauss(0.0, 15.0) if ppm is None else ppm)
        self.aligner = Aligner(
            control=profile.phase_control,
            period_ns=profile.period_ns,
            tolerance_ns=tolerance_ns,
            row_time_ns=profile.row_time_ns if row_known else None,
            exposure_ns=profile.exposure_ns,
            min_exposure_ns=profile.min_exposure_ns,
            max_exposure_ns=profile.max_exposure_ns,
            min_frame_duration_ns=profile.min_frame_duration_ns,
            max_frame_duration_ns=profile.max_frame_duration_ns,
            rng=rng,
            aimed=aimed,
            profile=known,
        )
        self.goal = goal or Goal(rng.randrange(START_NS), profile.period_ns)
        self.agreed_ns: int | None = None
        self.now_ns = 0
        self.commands: list[CameraCommand] = []
        self.dropped = 0
        self._clock_rng, self._clock_noise_ns = random.Random(rng.getrandbits(64)), clock_noise_ns
        self._next: SensorFrame
        for latency_ns in starts_seen:
            self.aligner.start_seen(latency_ns)
        self.start(rng.randrange(START_NS))

    @property
    def due_ns(self) -> int:
        """When the next frame is delivered."""
        return self._next.readout_end_true_ns + DELIVERY_NS

    def start(self, at_ns: int) -> None:
        """Start the stream, or start it anew."""
        self.sensor.restart(at_ns)
        self.aligner.stream_started(at_ns)
        self._next = self.sensor.next_frame()

    def take(self) -> SensorFrame:
        """Let the next frame's time come, and the aligner see the frame unless it was dropped."""
        frame, self.now_ns = self._next, self.due_ns
        self._next = self.sensor.next_frame()
        if frame.dropped:
            self.dropped += frame.sequence > 0
        else:
            self.aligner.frame(FrameStamp(frame.sequence, frame.stream, frame.timestamp_true_ns))
        return frame

    def deliver(self, *, hold: bool = False) -> Look | None:
        """Deliver the next frame at its time; None where it was dropped."""
        frame = self.take()
        return None if frame.dropped else self.judge(frame, hold=hold)

    def judge(
        self, frame: SensorFrame, *, hold: bool = False, burst_ns: tuple[int, int] | None = None
    ) -> Look:
        """Let the aligner judge its stream after that frame, and carry out what it asks for.

        `burst_ns` are the first and last instant of a burst that is due.
        """
        now_ns = self.now_ns
        offset_ns = round(self._clock_rng.gauss(0.0, self._clock_noise_ns)) if self._clock_noise_ns else 0
        time_map = TimeMap(0, offset_ns, 0.0, 0.0, 0.0, 0.0, 0.0, 300, 1000)
        command = self.aligner.step(
            time_map,
            self.goal,
            now_ns,
            hold=hold,
            burst_leader_ns=burst_ns,
            agreed_leader_ns=self.agreed_ns,
        )
        error_ns = self.goal.phase_error(frame.start_true_ns)
        look = Look(now_ns, error_ns, self.aligner.aligned, self.aligner.corrections)
        if command is not None:
            self.commands.append(command)
            self.obey(command, now_ns)
        return look

    def obey(self, command: CameraCommand, now_ns: int) -> None:
        """Let the sensor carry out a command."""
        match command:
            case InjectFrame(exposure_ns):
                self.sensor.inject(exposure_ns, now_ns)
            case SetFrameDuration(duration_ns):
                self.sensor.set_frame_duration(duration_ns, now_ns)
            case RestartStream(delay_ns):
                self.start(now_ns + delay_ns)

    def run(
        self, duration_ns: int, *, until: Callable[[Look], bool] = lambda _: False, hold: bool = False
    ) -> list[Look]:
        """Deliver frames for that long, or until one fulfils the condition; return how they looked."""
        end_ns = self.due_ns + duration_ns
        looks: list[Look] = []
        while self.due_ns < end_ns and not (looks and until(looks[-1])):
            look = self.deliver(hold=hold)
            if look is not None:
                looks.append(look)
        return looks
