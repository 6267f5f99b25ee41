"""One simulated camera and its aligner, frame by frame in stepped time; the clock is known exactly.

For what does not need a network: local, leader and true time are the same, save for the clock's error that a
test adds.
"""

import csv
import random
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from capture_app.errors import BadInputError
from capture_app.simulation.devices.sensor import Sensor, SensorFrame, SensorProfile
from capture_app.simulation.network.delay_laws import ReplayedDelay
from capture_app.simulation.network.link import Channel, Link
from capture_app.sync.clock.clock_sample import ClockSample
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.aligner import Aligner
from capture_app.sync.phase.estimator import FrameStamp
from capture_app.sync.phase.goal import Goal
from capture_app.sync.phase.injection import InjectionProfile
from capture_app.sync.wire.camera_commands import CameraCommand, InjectFrame, RestartStream, SetFrameDuration

COLUMNS = ("t_s", "rtt_ms")
LEAST_ROWS = 50


def read_trace(path: Path, rng: random.Random) -> Link:
    """Read a CSV with the columns t_s and rtt_ms as a link that replays it row by row, at its own pace.

    A recording does not tell how a round trip divides: both ways get half the least round trip, and what a
    row has above that is divided by chance. Raises BadInputError.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = [tuple(float(row[name]) for name in COLUMNS) for row in csv.DictReader(file)]
    except (OSError, KeyError, TypeError, ValueError, UnicodeDecodeError) as error:
        raise BadInputError(
            f"cannot read the recorded link {path}: {error}", hint=f"a CSV with columns {', '.join(COLUMNS)}"
        ) from None
    if len(rows) < LEAST_ROWS:
        raise BadInputError(f"{path} has {len(rows)} rows", hint=f"{LEAST_ROWS} or more are needed")
    times_s, round_trips_ms = zip(*rows, strict=True)
    every_ns = round((times_s[-1] - times_s[0]) / (len(rows) - 1) * 1e9)
    least_ms = min(round_trips_ms)
    if every_ns <= 0 or not least_ms > 0:
        raise BadInputError(f"{path} has times that do not ascend, or round trips that are not positive")
    there_ns, back_ns = [], []
    for round_trip_ms in round_trips_ms:
        part_ms = rng.random() * (round_trip_ms - least_ms)
        there_ns.append(round((least_ms / 2.0 + part_ms) * 1e6))
        back_ns.append(round((round_trip_ms - least_ms / 2.0 - part_ms) * 1e6))
    return Link(ReplayedDelay(tuple(there_ns), every_ns), ReplayedDelay(tuple(back_ns), every_ns))


TURNAROUND_NS = 30_000
"""From the receipt of a request to the reply, at the leader."""
START_TRUE_NS = 10**12


class LocalClock(Protocol):
    """A client's clock, steady or not."""

    def local_from_true(self, true_ns: int) -> int:
        """Reading of this clock in ns at a true time in ns."""


@dataclass(frozen=True, slots=True)
class Exchange:
    """A sample and the true time in ns at which its reply arrived; the leader's clock is the true time."""

    sample: ClockSample
    arrived_true_ns: int
    there_ns: int
    back_ns: int


def exchanges(
    link: Link, clock: LocalClock, rng: random.Random, *, count: int, pace_ns: int
) -> list[Exchange]:
    """Send `count` requests, one each `pace_ns`, and return those that came back, in the order they did.

    A duplicated datagram counts when it first arrives, as in the engine.
    """
    return exchanges_at(link, clock, rng, range(START_TRUE_NS, START_TRUE_NS + count * pace_ns, pace_ns))


def exchanges_at(
    link: Link, clock: LocalClock, rng: random.Random, sent_true_ns: Iterable[int]
) -> list[Exchange]:
    """Send a request at each of these true times in ns; return what comes back as `exchanges` does."""
    return sorted(_sent(link, clock, rng, sent_true_ns), key=lambda e: e.arrived_true_ns)


def _sent(
    link: Link, clock: LocalClock, rng: random.Random, sent_true_ns: Iterable[int]
) -> Iterator[Exchange]:
    channel = Channel(link)
    for sent_ns in sent_true_ns:
        there = channel.deliveries("to_leader", sent_ns, rng)
        if not there:
            continue
        t1_ns = sent_ns + min(there)
        t2_ns = t1_ns + TURNAROUND_NS
        back = channel.deliveries("to_client", t2_ns, rng)
        if back:
            t3_ns = t2_ns + min(back)
            local_ns = clock.local_from_true(sent_ns), clock.local_from_true(t3_ns)
            sample = ClockSample(local_ns[0], t1_ns, t2_ns, local_ns[1])
            yield Exchange(sample, t3_ns, min(there), min(back))


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
            self.aligner.learn_start_latency(latency_ns)
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
            meeting_leader_ns=self.agreed_ns,
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
