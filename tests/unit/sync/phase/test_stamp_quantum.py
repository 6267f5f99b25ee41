"""Steps of timestamps: found where they are, not where they are not, and claims that follow them."""

import random
from dataclasses import replace
from itertools import pairwise
from math import floor

import pytest

from benchmarks.paper.phase_trials import EXACT, unknown_phone
from benchmarks.simulated.aligner_bench import Bench
from capture_app.sync.phase.frame_line import StampQuantum, find_quantum

S = 1_000_000_000
PERIOD_NS = 33_333_000 * (1 + 17e-6)


def intervals(
    step_ns: float,
    *,
    period_ns: float = PERIOD_NS,
    noise_ns: float = 3000.0,
    jitter_ns: float = 0.0,
    seed: int = 1,
) -> list[int]:
    """Intervals of 90 frames, 1 % of them late by up to 1 ms; jitter comes after the step."""
    rng = random.Random(seed)
    stamps = []
    for n in range(90):
        true_ns = (
            12_345_678 + n * period_ns + rng.gauss(0.0, noise_ns) + (rng.random() < 0.01) * rng.random() * 1e6
        )
        cut_ns = floor(true_ns / step_ns) * step_ns if step_ns else true_ns
        stamps.append(round(cut_ns + rng.gauss(0.0, jitter_ns)))
    return [later - earlier for earlier, later in pairwise(stamps)]


@pytest.mark.parametrize("step_ns", [1e6, 1e9 / 90_000, 1e4, 1e3])
@pytest.mark.parametrize("period_ns", [PERIOD_NS, 16_666_666 * (1 - 30e-6), 40_000_360.0])
def test_a_step_is_found(step_ns: float, period_ns: float) -> None:
    assert find_quantum(intervals(step_ns, period_ns=period_ns)) == pytest.approx(step_ns, rel=0.01)


@pytest.mark.parametrize(("step_ns", "jitter_ns"), [(1e6, 10_000.0), (1e5, 1000.0), (1e4, 100.0)])
def test_a_step_is_found_under_the_jitter_of_another_clock(step_ns: float, jitter_ns: float) -> None:
    found = [find_quantum(intervals(step_ns, jitter_ns=jitter_ns, seed=seed)) for seed in range(9)]
    assert sorted(found)[4] == pytest.approx(step_ns, rel=0.15)


@pytest.mark.parametrize("noise_ns", [300.0, 3000.0, 20_000.0])
def test_fine_timestamps_have_no_step(noise_ns: float) -> None:
    assert not any(find_quantum(intervals(0.0, noise_ns=noise_ns, seed=seed)) for seed in range(60))


def test_a_while_at_another_rate_is_no_step() -> None:
    """As of a GigE camera whose answer is lost: a frame's duration then lasts for half a second."""
    seen = intervals(0.0, noise_ns=3_000.0, seed=1)
    seen[30:45] = [interval + 225_000 for interval in seen[30:45]]
    assert find_quantum(seen) == 0.0


def test_a_period_of_whole_steps_hides_nothing() -> None:
    assert find_quantum([40_000_000] * 60) == 1e6


def test_even_frames_closer_than_half_a_coarse_step_have_a_finer_one() -> None:
    assert find_quantum([400_000] * 60) == 2e5


@pytest.mark.parametrize("ppm", [-200.0, -30.0, 30.0, 200.0])
@pytest.mark.parametrize("period_ns", [PERIOD_NS, 40_000_000.0])
def test_steps_of_a_clock_that_runs_differently_are_found(ppm: float, period_ns: float) -> None:
    seen = [round(ns * (1 + ppm * 1e-6)) for ns in intervals(1e6, period_ns=period_ns, noise_ns=0.0)]
    if period_ns == 40_000_000.0:
        seen = [round(40_000_000 * (1 + ppm * 1e-6))] * 60
    assert find_quantum(seen) == pytest.approx(1e6 * (1 + ppm * 1e-6), rel=1e-6)


def test_a_step_that_is_known_stays_known_while_no_interval_shows_it() -> None:
    step = StampQuantum()
    for interval_ns in intervals(1e6):
        step.add(interval_ns)
    for _ in range(40):
        step.add(33_000_000)
    assert step.ns == pytest.approx(1e6)


def coarse_bench(seed: int, step_ns: float, tolerance_ns: int, *, cut: bool) -> Bench:
    """A phone of an unknown model whose timestamps come in steps."""
    phone = unknown_phone(random.Random(seed))
    phone = replace(phone, timestamp_quantum_ns=step_ns, timestamps_cut=cut)
    return Bench(phone, seed, tolerance_ns)


@pytest.mark.parametrize("cut", [True, False])
@pytest.mark.parametrize(
    ("step_ns", "tolerance_ns"), [(1e6, 100_000), (1e6, 1_000_000), (1e9 / 90_000, 20_000)]
)
def test_no_frame_is_off_by_more_than_is_said(step_ns: float, tolerance_ns: int, cut: bool) -> None:
    said = off_aligned = off_window = off_uncertainty = 0
    for seed in range(3):
        bench = coarse_bench(seed, step_ns, tolerance_ns, cut=cut)
        aligner = bench.aligner
        bench.run(20 * S, until=lambda _, aligner=aligner: aligner.window.within_window)  # type: ignore[misc]
        for _ in range(300):
            look, now = bench.deliver(), bench.aligner.estimate(EXACT, bench.grid, bench.now_ns)
            if look is None or now is None or not aligner.window.within_window:
                continue
            said += 1
            off_aligned += look.aligned and abs(look.error_ns) > 1.1 * tolerance_ns
            off_window += abs(look.error_ns) > aligner.window.tolerance_ns
            off_uncertainty += abs(look.error_ns - now.error_ns) > 2.0 * now.sigma_ns + now.quantum_error_ns
    assert said > 250
    assert off_aligned + off_window <= 0.01 * said
    assert off_uncertainty <= 0.05 * said


def test_quantization_coarser_than_the_tolerance_is_reported() -> None:
    bench = coarse_bench(1, 1e6, 100_000, cut=True)
    looks = bench.run(20 * S)
    assert not any(look.aligned for look in looks)
    assert bench.aligner.window.within_window
    assert bench.aligner.phase.quantum_ns == pytest.approx(1e6)
    assert 400_000 < bench.aligner.window.tolerance_ns < 1_100_000
    assert "steps of 1.0 ms" in bench.aligner.window.degradation
    fine = coarse_bench(1, 1e3, 20_000, cut=True)
    fine.run(20 * S)
    assert fine.aligner.window.tolerance_ns == 20_000
    assert not fine.aligner.window.degradation


def test_a_drift_beyond_injection_is_reported_and_met_at_a_burst() -> None:
    phone = unknown_phone(random.Random(0))
    held, fleeting, slow = (Bench(phone, 0, 20_000, ppm=ppm) for ppm in (100.0, 300.0, 5.0))
    for bench in (held, fleeting, slow):
        bench.run(20 * S)
    shares = [sum(look.aligned for look in bench.run(10 * S)) / 300 for bench in (held, slow)]
    assert shares[0] > 0.4
    assert shares[1] > 0.85
    assert not slow.aligner.window.fleetingness
    assert "a second" in held.aligner.window.fleetingness
    commands = len(fleeting.commands)
    fleeting.run(5 * S)
    assert len(fleeting.commands) == commands, "no long frame that would do nothing"
    assert fleeting.aligner.meets_bursts
    at_ns = fleeting.grid.instant(fleeting.grid.index_of(fleeting.now_ns + S))
    errors = []
    while fleeting.now_ns < at_ns + S // 10:
        frame = fleeting.next_frame()
        if abs(frame.start_true_ns - at_ns) < PERIOD_NS / 2:
            errors.append(fleeting.grid.phase_error(frame.start_true_ns))
        if not frame.dropped:
            fleeting.step_aligner(frame, burst_ns=(at_ns, at_ns))
    assert abs(errors[0]) < 20_000
