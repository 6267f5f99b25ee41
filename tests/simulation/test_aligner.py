"""The aligner on simulated sensors, frame by frame, in stepped time."""

import random
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_app.simulation.devices.profiles import PROFILES
from capture_app.simulation.devices.sensor import Sensor, SensorProfile
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.aligner import Aligner
from capture_app.sync.phase.estimator import FrameStamp
from capture_app.sync.phase.goal import Goal
from capture_app.sync.wire.camera_commands import CameraCommand, InjectFrame, RestartStream, SetFrameDuration

S = 1_000_000_000
SAME_CLOCK = TimeMap(0, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 300, 1000)


@dataclass
class Look:
    """What one frame looked like: its true error, and what the aligner held of it."""

    now_ns: int
    error_ns: int
    aligned: bool
    corrections: int


@dataclass
class Bench:
    """One sensor and its aligner; local, leader and true time are the same."""

    profile: SensorProfile
    seed: int
    tolerance_ns: int
    ppm: float | None = None
    row_known: bool = True
    aimed: bool = True
    goal_period_ns: int | None = None
    looks: list[Look] = field(default_factory=list)
    commands: list[CameraCommand] = field(default_factory=list)
    dropped: int = 0

    def __post_init__(self) -> None:
        rng, p = random.Random(self.seed), self.profile
        self.sensor = Sensor(p, rng, period_error_ppm=rng.gauss(0.0, 15.0) if self.ppm is None else self.ppm)
        self.aligner = Aligner(
            control=p.phase_control,
            period_ns=p.period_ns,
            tolerance_ns=self.tolerance_ns,
            row_time_ns=p.row_time_ns if self.row_known else None,
            exposure_ns=p.exposure_ns,
            min_exposure_ns=p.min_exposure_ns,
            max_exposure_ns=p.max_exposure_ns,
            min_frame_duration_ns=p.min_frame_duration_ns,
            max_frame_duration_ns=p.max_frame_duration_ns,
            rng=rng,
            aimed=self.aimed,
        )
        self.goal = Goal(rng.randrange(S), self.goal_period_ns or p.period_ns)
        self.start(rng.randrange(S))

    def start(self, at_ns: int) -> None:
        self.sensor.restart(at_ns)
        self.aligner.stream_started(at_ns)

    def run(self, seconds: float, *, until: Callable[[], bool] | None = None, hold: bool = False) -> None:
        """Deliver frames, true times in ns, until so long after the first one."""
        end_ns = (self.looks[-1].now_ns if self.looks else 0) + int(seconds * S)
        now_ns = 0
        while now_ns < end_ns and not (until and self.looks and until()):
            frame = self.sensor.next_frame()
            now_ns = frame.readout_end_true_ns + 5_000_000
            if frame.dropped:
                self.dropped += frame.sequence > 0
                continue
            stamp = FrameStamp(frame.sequence, frame.stream, frame.timestamp_true_ns)
            self.aligner.frame(stamp)
            command = self.aligner.step(SAME_CLOCK, self.goal, now_ns, hold=hold)
            error_ns = self.goal.phase_error(frame.start_true_ns)
            self.looks.append(Look(now_ns, error_ns, self.aligner.aligned, self.aligner.corrections))
            if command is not None:
                self.commands.append(command)
            match command:
                case InjectFrame(exposure_ns):
                    self.sensor.inject(exposure_ns, now_ns)
                case SetFrameDuration(duration_ns):
                    self.sensor.set_frame_duration(duration_ns, now_ns)
                case RestartStream(delay_ns):
                    self.start(now_ns + delay_ns)

    def until_aligned(self) -> int:
        """Corrections it took."""
        self.run(400, until=lambda: self.looks[-1].aligned)
        assert self.looks[-1].aligned
        return self.aligner.corrections


def unknown_phone(seed: int) -> SensorProfile:
    rng = random.Random(seed)
    row_ns = rng.choice((8_000, 10_840, 12_300, 15_000))
    return replace(
        PROFILES["phone-a"],
        row_time_ns=row_ns,
        frame_length_rows=round(33_333_000 / row_ns),
        margin_rows=rng.randint(2, 60),
        injection_gain=rng.choice((1, 2, 3)),
    )


@pytest.mark.parametrize(("row_known", "mean_at_most"), [(True, 2.2), (False, 2.6)])
def test_unknown_phones_come_to_20_us_within_about_two_injections(
    row_known: bool, mean_at_most: float
) -> None:
    corrections = []
    for seed in range(12):
        bench = Bench(unknown_phone(seed), seed, 20_000, row_known=row_known)
        corrections.append(bench.until_aligned())
        assert abs(bench.looks[-1].error_ns) < 26_000
    assert sum(corrections) / len(corrections) <= mean_at_most


@pytest.mark.parametrize("name", ["phone-a", "phone-b", "perfect"])
@pytest.mark.parametrize("ppm", [-100.0, 20.0, 100.0])
def test_a_drifting_phone_is_held_calmly(name: str, ppm: float) -> None:
    bench = Bench(PROFILES[name], 5, 60_000, ppm=ppm)
    bench.run(40)
    later = [look for look in bench.looks if look.now_ns > 8 * S]
    held = [look for look in later if look.aligned]
    assert all(abs(look.error_ns) <= 66_000 for look in held)
    assert len(held) > (0.6 if abs(ppm) > 50 else 0.9) * len(later)
    # A drift of 100 us a second in a band of 120 us wants one correction a second, not many.
    assert bench.aligner.corrections <= 4 + 40 * max(abs(ppm), 10.0) / 80.0
    assert bench.aligner.drops == bench.dropped, "an injected frame is not a drop"


def test_a_phone_without_drift_is_aligned_once_and_left_alone() -> None:
    bench = Bench(PROFILES["pi"], 3, 60_000, ppm=0.0)
    bench.run(60)
    assert bench.aligner.corrections <= 2
    assert all(look.aligned for look in bench.looks if look.now_ns > 5 * S)


def test_nothing_begins_while_a_burst_is_due() -> None:
    bench = Bench(PROFILES["phone-a"], 5, 60_000, ppm=100.0)
    bench.until_aligned()
    before = len(bench.commands)
    bench.run(3, hold=True)
    assert len(bench.commands) == before
    assert not bench.aligner.aligned, "300 us of drift went by"
    bench.run(3)
    assert len(bench.commands) > before


@pytest.mark.parametrize(("aimed", "mean_at_most"), [(True, 6.0), (False, 16.0)])
def test_webcams_come_to_2_ms_by_restarts(aimed: bool, mean_at_most: float) -> None:
    tries = []
    for seed in range(16):
        bench = Bench(PROFILES["webcam"], seed, 2_000_000, aimed=aimed)
        tries.append(bench.until_aligned())
        assert abs(bench.looks[-1].error_ns) <= 2_010_000
    assert sum(tries) / len(tries) < mean_at_most


@pytest.mark.parametrize("noise_ns", [3_000, 2_500_000])
@pytest.mark.parametrize("ppm", [-60.0, 60.0])
def test_a_webcam_is_held_within_2_ms_even_in_a_virtual_machine(noise_ns: int, ppm: float) -> None:
    profile = replace(
        PROFILES["webcam"], timestamp_noise_ns=noise_ns, start_latency_ns=(250_000_000, 1_000_000)
    )
    bench = Bench(profile, 3, 2_000_000, ppm=ppm)
    bench.run(100)
    later = [look for look in bench.looks if look.now_ns > 20 * S]
    assert sum(look.aligned for look in later) > 0.9 * len(later)
    assert all(abs(look.error_ns) < 3_000_000 for look in later if look.aligned)
    assert bench.aligner.corrections < 15


@pytest.mark.parametrize("name", ["phone-a", "webcam"])
def test_rates_that_differ_are_a_problem_in_plain_words(name: str) -> None:
    bench = Bench(PROFILES[name], 3, 2_000_000, goal_period_ns=40_000_000)
    bench.run(20)
    assert "30.000 frames a second and the rig at 25.000" in bench.aligner.problem
    assert bench.commands == []
    assert not bench.aligner.aligned


def test_a_phone_that_cannot_expose_for_long_is_a_problem() -> None:
    bench = Bench(replace(PROFILES["phone-a"], max_exposure_ns=33_000_000), 3, 60_000)
    bench.run(10)
    assert "longest exposure of 33.0 ms is too short" in bench.aligner.problem
    assert bench.commands == []


def test_a_command_that_was_lost_is_given_again() -> None:
    bench = Bench(PROFILES["webcam"], 3, 100_000)
    lost: list[int] = []
    bench.start = lost.append  # type: ignore[method-assign, assignment]
    bench.run(10)
    assert len(lost) == 1, "one command at a time"
    bench.run(10)
    assert len(lost) == 2


def test_without_a_way_to_move_it_a_camera_still_tells_its_phase() -> None:
    aligner = Aligner(control="none", period_ns=33_333_333, tolerance_ns=50_000, rng=random.Random(1))
    goal = Goal(0, 33_333_333)
    for n in range(100):
        local_ns = n * 33_333_333 + 9_000_000
        aligner.frame(FrameStamp(n, 0, local_ns))
        assert aligner.step(SAME_CLOCK, goal, local_ns) is None
    assert aligner.settled
    assert not aligner.aligned
    estimate = aligner.estimate(SAME_CLOCK, goal, 120 * 33_333_333)
    assert estimate is not None
    assert estimate.error_ns == pytest.approx(9_000_000, abs=1000)
    assert estimate.drift_ppm == pytest.approx(0.0, abs=1.0)


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(["injection", "reset", "none"]),
    st.lists(
        st.tuples(st.integers(0, 5), st.integers(0, 2), st.integers(-(10**9), 10**11), st.booleans()),
        max_size=120,
    ),
    st.integers(1, 10**9),
)
def test_no_stream_whatsoever_raises(
    control: str, frames: list[tuple[int, int, int, bool]], goal_period_ns: int
) -> None:
    """Any numbers, streams and times, and goals that make no sense."""
    aligner = Aligner(control=control, period_ns=33_333_333, tolerance_ns=60_000, rng=random.Random(1))
    sequence, stream, now_ns = 0, 0, 0
    for steps, streams, interval_ns, started in frames:
        sequence, stream, now_ns = sequence + steps, stream + streams, now_ns + interval_ns
        if started:
            aligner.stream_started(now_ns)
        aligner.frame(FrameStamp(sequence, stream, now_ns))
        aligner.step(SAME_CLOCK, Goal(0, goal_period_ns), now_ns)
