"""The aligner on simulated sensors, frame by frame, in stepped time."""

import random
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.paper.phase_trials import known_profile, unknown_phone
from benchmarks.simulated.aligner_bench import Bench, FrameObservation
from capture_app.common.camera_facts import PhaseControl
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.aligner import Aligner
from capture_app.sync.phase.estimator import FrameStamp
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.rig.client import Client, ClientConfig
from capture_app.sync.wire.camera_commands import CameraCommand
from tests.facts import make_facts

S = 1_000_000_000
SAME_CLOCK = TimeMap(0, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 300, 1000)


def until_aligned(bench: Bench) -> FrameObservation:
    """Let frames come until the stream is aligned; return the last one."""
    last = bench.run(400 * S, until=lambda observation: observation.aligned)[-1]
    assert last.aligned
    return last


@pytest.mark.parametrize(("row_known", "mean_at_most"), [(True, 2.2), (False, 3.0)])
def test_unknown_phones_come_to_20_us_within_about_two_injections(
    row_known: bool, mean_at_most: float
) -> None:
    corrections = []
    for seed in range(12):
        bench = Bench(unknown_phone(random.Random(seed)), seed, 20_000, row_known=row_known)
        last = until_aligned(bench)
        corrections.append(last.corrections)
        assert abs(last.error_ns) < 26_000
    assert sum(corrections) / len(corrections) <= mean_at_most


@pytest.mark.parametrize("name", ["phone-a", "phone-b", "perfect"])
@pytest.mark.parametrize("ppm", [-100.0, 20.0, 100.0])
def test_a_drifting_phone_is_held_calmly(name: str, ppm: float) -> None:
    bench = Bench(PROFILES[name], 5, 60_000, ppm=ppm)
    later = [seen for seen in bench.run(40 * S) if seen.now_ns > 8 * S]
    held = [seen for seen in later if seen.aligned]
    assert all(abs(seen.error_ns) <= 66_000 for seen in held)
    assert len(held) > (0.6 if abs(ppm) > 50 else 0.9) * len(later)
    # A drift of 100 us a second in a band of 120 us wants one correction a second, not many.
    assert bench.aligner.corrections <= 4 + 40 * max(abs(ppm), 10.0) / 80.0
    assert bench.aligner.phase.drops == bench.dropped, "an injected frame is not a drop"


def test_a_phone_without_drift_is_aligned_once_and_left_alone() -> None:
    bench = Bench(PROFILES["pi"], 3, 60_000, ppm=0.0)
    observations = bench.run(60 * S)
    assert bench.aligner.corrections <= 2
    assert all(seen.aligned for seen in observations if seen.now_ns > 5 * S)


def test_a_stream_that_is_just_started_is_not_aligned() -> None:
    bench = Bench(PROFILES["pi"], 3, 60_000, ppm=0.0)
    last = until_aligned(bench)
    bench.aligner.note_stream_start(last.now_ns)
    assert not bench.aligner.window.aligned
    assert not bench.aligner.window.within_window


def test_two_late_timestamps_among_the_first_frames_move_nothing() -> None:
    profile = replace(PROFILES["phone-a"], outlier_fraction=0.0, drop_fraction=0.0)
    bench = Bench(profile, 3, 20_000, ppm=0.0, known=known_profile(profile))
    until_aligned(bench)
    commands = []
    for late_ns in (463_000, 546_000):
        frame = bench.sensor.next_frame()
        stamp = FrameStamp(frame.sequence, frame.stream, frame.timestamp_true_ns + late_ns)
        bench.aligner.add_frame(stamp)
        commands.append(bench.aligner.next_command(SAME_CLOCK, bench.grid, stamp.timestamp_ns))
    assert commands == [None, None]


def test_nothing_begins_while_a_burst_is_due() -> None:
    bench = Bench(PROFILES["phone-a"], 5, 60_000, ppm=100.0)
    until_aligned(bench)
    before = len(bench.commands)
    bench.run(3 * S, hold=True)
    assert len(bench.commands) == before
    assert not bench.aligner.window.aligned, "300 us of drift went by"
    bench.run(3 * S)
    assert len(bench.commands) > before


@pytest.mark.parametrize(("aimed", "mean_at_most"), [(True, 6.0), (False, 16.0)])
def test_webcams_come_to_2_ms_by_restarts(aimed: bool, mean_at_most: float) -> None:
    tries = []
    for seed in range(16):
        bench = Bench(PROFILES["webcam"], seed, 2_000_000, aimed=aimed)
        last = until_aligned(bench)
        tries.append(last.corrections)
        assert abs(last.error_ns) <= 2_010_000
    assert sum(tries) / len(tries) < mean_at_most


@pytest.mark.parametrize(("noise_ns", "ppm"), [(3_000, -60.0), (2_500_000, 60.0)])
def test_a_webcam_is_held_within_2_ms_even_in_a_virtual_machine(noise_ns: int, ppm: float) -> None:
    profile = replace(
        PROFILES["webcam"], timestamp_noise_ns=noise_ns, start_latency_ns=(250_000_000, 1_000_000)
    )
    bench = Bench(profile, 3, 2_000_000, ppm=ppm)
    later = [seen for seen in bench.run(100 * S) if seen.now_ns > 20 * S]
    assert sum(seen.aligned for seen in later) > 0.9 * len(later)
    assert all(abs(seen.error_ns) < 3_000_000 for seen in later if seen.aligned)
    assert bench.aligner.corrections < 15


@pytest.mark.parametrize("name", ["phone-a", "webcam"])
def test_a_stream_of_another_rate_passes_by_unmoved(name: str) -> None:
    bench = Bench(PROFILES[name], 3, 2_000_000, grid=FrameGrid(5, 40_000_000))
    bench.run(20 * S)
    assert "30.00 frames/s and the rig at 25.00: each instant" in bench.aligner.other_rate
    assert bench.aligner.problem == ""
    assert bench.commands == []
    assert not bench.aligner.window.aligned


def test_a_phone_that_cannot_expose_for_long_is_a_problem() -> None:
    bench = Bench(replace(PROFILES["phone-a"], max_exposure_ns=33_000_000), 3, 60_000)
    bench.run(10 * S)
    assert "longest exposure of 33.0 ms is too short" in bench.aligner.problem
    assert bench.commands == []


class DeafBench(Bench):
    """A camera that carries out no command."""

    def apply(self, command: CameraCommand, now_ns: int) -> None:
        pass


def test_a_command_that_was_lost_is_given_again() -> None:
    bench = DeafBench(PROFILES["webcam"], 3, 100_000)
    bench.run(10 * S)
    assert len(bench.commands) == 1, "one command at a time"
    bench.run(10 * S)
    assert len(bench.commands) == 2


def test_a_camera_without_phase_control_still_reports_its_phase() -> None:
    aligner = Aligner(make_facts(phase_control=PhaseControl.NONE), tolerance_ns=50_000, rng=random.Random(1))
    grid = FrameGrid(0, 33_333_333)
    for n in range(100):
        local_ns = n * 33_333_333 + 9_000_000
        aligner.add_frame(FrameStamp(n, 0, local_ns))
        assert aligner.next_command(SAME_CLOCK, grid, local_ns) is None
    assert aligner.settled
    assert not aligner.window.aligned
    estimate = aligner.estimate(SAME_CLOCK, grid, 120 * 33_333_333)
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
    """Any numbers, streams and times, and grids that make no sense."""
    camera = make_facts(phase_control=PhaseControl(control))
    aligner = Aligner(camera, tolerance_ns=60_000, rng=random.Random(1))
    sequence, stream, now_ns = 0, 0, 0
    for steps, streams, interval_ns, started in frames:
        sequence, stream, now_ns = sequence + steps, stream + streams, now_ns + interval_ns
        if started:
            aligner.note_stream_start(now_ns)
        aligner.add_frame(FrameStamp(sequence, stream, now_ns))
        aligner.next_command(SAME_CLOCK, FrameGrid(0, goal_period_ns), now_ns)


def test_start_latencies_of_one_use_save_restarts_on_the_next() -> None:
    steady = replace(PROFILES["webcam"], start_latency_ns=(275_000_000, 1_000_000))

    def aligned(seed: int, starts_seen: tuple[int, ...] = ()) -> Bench:
        bench = Bench(steady, seed, 1_000_000, start_latencies_ns=starts_seen)
        until_aligned(bench)
        return bench

    first = [aligned(seed) for seed in range(24)]
    again = [aligned(seed, first[seed - 1].aligner.start_latencies_ns) for seed in range(24)]
    restarts = [sum(bench.aligner.corrections for bench in benches) for benches in (first, again)]
    assert restarts[1] <= 0.9 * restarts[0]


@pytest.mark.parametrize(("control", "known"), [("reset", (5_000_000, 6_000_000)), ("none", ())])
def test_a_client_starts_with_the_saved_injection_profile(control: str, known: tuple[int, ...]) -> None:
    camera = make_facts(phase_control=PhaseControl(control))
    config = ClientConfig("cam", 1, camera, 2_000_000, 90, start_latencies_ns=(5_000_000, 6_000_000))
    client: Client[None] = Client(config, random.Random(1))
    assert client.aligner.start_latencies_ns == known
