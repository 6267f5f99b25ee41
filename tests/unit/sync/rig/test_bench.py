"""Frame durations, groups that can only restart, and the panel's pictures, in stepped time."""

import random
from dataclasses import replace

import pytest

from benchmarks.paper.phase_trials import (
    align_one_camera,
    inject_like_libsoftwaresync,
    known_profile,
    restart_like_the_paper,
    restart_together,
    unknown_phone,
)
from benchmarks.simulated.aligner_bench import Bench
from capture_app.plugins.cameras.sim.profiles import PROFILES

S = 1_000_000_000


@pytest.mark.parametrize("ppm", [-20.0, 20.0])
def test_frame_durations_hold_a_phase_to_half_a_row(ppm: float) -> None:
    profile = replace(
        PROFILES["pi"],
        row_time_ns=20_000,
        frame_length_rows=1667,
        min_frame_rows=800,
        timestamp_noise_ns=3_000,
        outlier_fraction=0.01,
        drop_fraction=0.01,
    )
    bench = Bench(profile, 3, 50_000, ppm=ppm)
    looks = [look for look in bench.run(30 * S) if look.now_ns > 6 * S]
    errors = sorted(abs(look.error_ns) for look in looks)
    assert errors[int(0.99 * len(errors))] <= 16_000
    assert all(look.aligned for look in looks)
    assert bench.aligner.corrections == 1, "one large step; the small ones disturb nothing"
    assert bench.aligner.phase.drops == bench.dropped


def test_small_steps_go_on_while_a_burst_is_due_and_large_ones_wait() -> None:
    bench = Bench(PROFILES["pi"], 5, 50_000, ppm=100.0)
    bench.run(4 * S)
    before = len(bench.commands)
    looks = bench.run(4 * S, hold=True)
    assert len(bench.commands) > before
    assert all(abs(look.error_ns) < 40_000 for look in looks)
    fresh = Bench(PROFILES["pi"], 5, 50_000)
    fresh.run(4 * S, hold=True)
    assert fresh.commands == []


def test_unknown_phones_take_two_injections_and_known_ones_one() -> None:
    phones = [unknown_phone(random.Random(n)) for n in range(20)]
    unknown = [align_one_camera(phone, n, 20_000) for n, phone in enumerate(phones)]
    known = [
        align_one_camera(PROFILES["phone-a"], n, 20_000, known=known_profile(PROFILES["phone-a"]))
        for n in range(20)
    ]
    assert sum(way.moves for way in unknown) <= 2.15 * len(unknown)
    assert all(way.moves == 1 for way in known)
    theirs = [inject_like_libsoftwaresync(phone, n, 20_000) for n, phone in enumerate(phones)]
    assert sum(way.seconds is None for way in theirs) > len(theirs) / 2


def aligned_phone(ppm: float) -> Bench:
    """A known phone, drifting, that has come to its grid."""
    bench = Bench(PROFILES["phone-a"], 6, 60_000, ppm=ppm, known=known_profile(PROFILES["phone-a"]))
    bench.run(30 * S, until=lambda look: look.aligned)
    return bench


def burst_after(bench: Bench, ahead_ns: int) -> int:
    """Let a burst of one frame come, told so long before; return the true error of its frame in ns."""
    at_ns = bench.grid.instant(bench.grid.index_of(bench.now_ns + ahead_ns))
    while True:
        frame = bench.next_frame()
        if abs(frame.start_true_ns - at_ns) < bench.grid.period_ns // 2:
            assert frame.exposure_ns < bench.grid.period_ns, "no long frame in a burst"
            return bench.grid.phase_error(frame.start_true_ns)
        assert frame.start_true_ns < at_ns + bench.grid.period_ns
        if not frame.dropped:
            bench.step_aligner(frame, burst_ns=(at_ns, at_ns))


@pytest.mark.parametrize("ahead_ns", [450_000_000, 1_900_000_000])
@pytest.mark.parametrize("ppm", [-30.0, 30.0])
def test_a_phone_is_brought_to_its_goal_for_a_burst(ppm: float, ahead_ns: int) -> None:
    bench = aligned_phone(ppm)
    errors = []
    for _ in range(5):
        bench.run(3 * S)
        errors.append(burst_after(bench, ahead_ns))
    assert max(map(abs, errors)) < 0.25 * 60_000 + 2_000
    assert sum(map(abs, errors)) < 5 * bench.profile.row_time_ns


def test_a_burst_that_is_too_near_is_left_in_peace() -> None:
    bench = aligned_phone(30.0)
    bench.run(3 * S)
    commands = len(bench.commands)
    burst_after(bench, 380_000_000)
    assert len(bench.commands) == commands


def test_cameras_that_only_restart_align_sooner_than_by_the_papers_method() -> None:
    webcam = PROFILES["webcam"]
    ours = [restart_together(webcam, 4, n, 1_000_000, aimed=True).seconds for n in range(4)]
    theirs = [restart_like_the_paper(webcam, 4, n, 1_000_000).seconds for n in range(30)]
    mine = [s for s in ours if s is not None]
    assert len(mine) == len(ours)
    assert sum(mine) / len(mine) < sum(s or 5000.0 for s in theirs) / len(theirs) / 3
