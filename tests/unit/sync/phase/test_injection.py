"""The exposures an injection controller asks for, and what it learns from the shifts."""

import random
from dataclasses import replace
from math import floor
from statistics import median

import pytest
from msgspec.structs import replace as replace_facts

from benchmarks.paper.phase_trials import unknown_phone
from benchmarks.simulated.aligner_bench import Bench
from capture_app.common.camera_facts import CameraFacts, PhaseControl
from capture_app.sync.phase.actuators import InjectionProfile, Move
from capture_app.sync.phase.frame_grid import Drift, setpoint_for_burst
from capture_app.sync.phase.injection import InjectionActuator
from capture_app.sync.wire.datagrams import CLOCK

PERIOD_NS = 33_333_000
ROW_NS = 10_840
S = 1_000_000_000


def move(shift_ns: int, tolerance_ns: int = 20_000) -> Move:
    return Move(0, shift_ns, shift_ns, PERIOD_NS, tolerance_ns)


def shift_of(exposure_ns: int, gain: float, overhead_ns: int) -> int:
    """What a sensor of whole rows does: gain * row * (floor(E / row) - neutral)."""
    neutral = (PERIOD_NS - overhead_ns) // ROW_NS
    return round(gain * ROW_NS * max(0, floor(exposure_ns / ROW_NS) - neutral))


def _camera(period_ns: int, row_ns: int | None, max_exposure_ns: int | None = None) -> CameraFacts:
    return replace_facts(
        CLOCK,
        phase_control=PhaseControl.INJECTION,
        period_ns=period_ns,
        row_time_ns=row_ns,
        max_exposure_ns=max_exposure_ns,
    )


def controller(
    *, row_known: bool = True, max_exposure_ns: int | None = None, profile: InjectionProfile | None = None
) -> InjectionActuator:
    return InjectionActuator(_camera(PERIOD_NS, ROW_NS if row_known else None, max_exposure_ns), profile)


def known_device(row_ns: int, frame_rows: int, gain: int, neutral_rows: float) -> InjectionActuator:
    profile = InjectionProfile(row_ns, gain, neutral_rows)
    return InjectionActuator(_camera(frame_rows * row_ns, row_ns), profile)


def exposure_for(inject: InjectionActuator, wanted: Move) -> int:
    """The exposure in ns that is commanded for a move."""
    command = inject.command(wanted)
    assert command is not None
    return command.exposure_ns


@pytest.mark.parametrize("row_known", [True, False])
@pytest.mark.parametrize("gain", [1, 2, 3])
@pytest.mark.parametrize("overhead_ns", [20_000, 250_000, 700_000])
@pytest.mark.parametrize("target_ns", [300_000, 9_000_000, 33_000_000])
def test_the_second_injection_hits(row_known: bool, gain: int, overhead_ns: int, target_ns: int) -> None:
    inject = controller(row_known=row_known)
    done_ns = shift_of(exposure_for(inject, move(target_ns)), gain, overhead_ns)
    assert done_ns > 0
    inject.learn(done_ns, 3000.0, None)
    assert inject.profile is not None
    assert inject.profile.gain == gain
    left_ns = (target_ns - done_ns) % PERIOD_NS
    second = inject.command(move(left_ns))
    if second is not None:
        left_ns -= shift_of(second.exposure_ns, gain, overhead_ns)
    miss_ns = (left_ns + PERIOD_NS // 2) % PERIOD_NS - PERIOD_NS // 2
    rows = 0.55 if row_known else 1.55
    assert abs(miss_ns) <= rows * gain * ROW_NS


@pytest.mark.parametrize("row_known", [True, False])
@pytest.mark.parametrize("gain", [1.05, 1.25, 1.46, 1.75, 1.9, 2.5])
def test_any_gain_is_learned_and_every_camera_aligned(gain: float, row_known: bool) -> None:
    corrections, gains = [], []
    for seed in range(6):
        phone = replace(unknown_phone(random.Random(seed)), injection_gain=gain)
        bench = Bench(phone, seed, 20_000, row_known=row_known)
        last = bench.run(40 * S, until=lambda look: look.aligned)[-1]
        assert last.aligned
        assert abs(last.error_ns) < 30_000
        assert bench.aligner.actuator.profile is not None
        corrections.append(last.corrections)
        gains.append(bench.aligner.actuator.profile.gain)
    assert max(corrections) <= 6
    assert median(gains) == pytest.approx(gain, abs=0.01)


@pytest.mark.parametrize("gain", [1.1, 1.46, 1.9])
@pytest.mark.parametrize("overhead_ns", [20_000, 250_000, 700_000])
def test_a_gain_that_is_no_whole_number_hits_with_its_third_injection(gain: float, overhead_ns: int) -> None:
    inject, left_ns, shots = controller(), 9_000_000, 0
    while min(left_ns, PERIOD_NS - left_ns) > 20_000:
        shift_ns = shift_of(exposure_for(inject, move(left_ns)), gain, overhead_ns)
        inject.learn(shift_ns, 3000.0, None)
        left_ns, shots = (left_ns - shift_ns) % PERIOD_NS, shots + 1
    assert shots <= 3


def test_an_exposure_that_fits_into_a_period_and_moves_nothing_is_no_proof_of_a_dead_camera() -> None:
    inject = controller(profile=InjectionProfile(ROW_NS, 1.0, 3000.0))
    for _ in range(12):
        # By a profile that is 60 rows off it takes a frame that is still shorter than a period.
        exposure_ns = exposure_for(inject, move(300_000))
        inject.learn(shift_of(exposure_ns, 1.0, 100_000), 3000.0, None)
    assert not inject.problem
    assert inject.profile is not None
    assert inject.profile.neutral_rows == pytest.approx((PERIOD_NS - 100_000) // ROW_NS, abs=1)


def test_the_first_injection_stretches_by_at_least_two_milliseconds() -> None:
    assert exposure_for(controller(), move(100_000)) > PERIOD_NS - 250_000 + 2_000_000 - ROW_NS


def test_exposures_lie_inside_a_row() -> None:
    assert exposure_for(controller(), move(9_000_000)) % ROW_NS == pytest.approx(ROW_NS / 4, abs=1)


def test_no_shift_at_all_asks_for_more_and_learns_nothing() -> None:
    inject = controller()
    first_ns = exposure_for(inject, move(100_000))
    inject.learn(400, 3000.0, None)
    assert inject.profile is None
    assert exposure_for(inject, move(100_000)) - first_ns == pytest.approx(1_000_000, abs=2 * ROW_NS)


def test_a_command_that_a_known_device_did_not_get_is_given_again_as_it_was() -> None:
    inject = controller(profile=InjectionProfile(ROW_NS, 2, 3050.0))
    assert inject.sure
    first = inject.command(move(9_000_000))
    inject.learn(400, 3000.0, None)
    assert not inject.sure, "nothing to be done just before a burst"
    assert inject.command(move(9_000_000)) == first
    inject.learn(9_007_000, 3000.0, None)
    assert inject.sure


def test_a_camera_that_never_obeys_is_a_problem_in_the_end() -> None:
    inject = controller()
    for _ in range(8):
        assert not inject.problem
        inject.command(move(100_000))
        inject.learn(0, 3000.0, None)
    assert "does not move" in inject.problem


def test_a_longest_exposure_below_the_period_is_a_problem() -> None:
    assert "too short" in controller(max_exposure_ns=30_000_000).problem
    assert not controller(max_exposure_ns=70_000_000).problem


def test_a_shift_beyond_the_maximum_is_done_in_part() -> None:
    inject = controller(max_exposure_ns=40_000_000, profile=InjectionProfile(ROW_NS, 1, 3050.0))
    assert 39_900_000 < exposure_for(inject, move(30_000_000)) <= 40_000_000


def test_an_error_below_what_rows_can_do_is_left_to_drift() -> None:
    inject = known_device(30_000, 1110, 3, 1100.0)
    assert inject.command(Move(0, 25_000, 25_000, 1110 * 30_000, 20_000)) is None


@pytest.mark.parametrize("frame_rows", [2222, 2221])
@pytest.mark.parametrize("wanted_rows", [1, 2, 301, 302])
def test_whole_periods_make_the_rows_between_two_steps_possible(frame_rows: int, wanted_rows: int) -> None:
    row_ns, neutral = 15_000, 2200
    inject = known_device(row_ns, frame_rows, 3, neutral)
    exposure_ns = exposure_for(inject, Move(0, 0, wanted_rows * row_ns, frame_rows * row_ns, 20_000))
    shift_rows = 3 * (exposure_ns // row_ns - neutral)
    assert (shift_rows - wanted_rows) % frame_rows == 0


def test_a_small_error_that_no_rows_can_mend_is_not_made_a_large_one() -> None:
    period_ns = 1110 * 30_000
    inject = known_device(30_000, 1110, 1, 1090.0)
    assert inject.command(Move(0, 0, period_ns - 16_000, period_ns, 15_000)) is None


def test_one_bad_observation_is_outvoted() -> None:
    inject = controller()
    for target_ns, wrong_ns in ((9_000_000, 0), (5_000_000, 0), (7_000_000, 900_000), (3_000_000, 0)):
        shift_ns = shift_of(exposure_for(inject, move(target_ns)), 2, 250_000)
        inject.learn(shift_ns + wrong_ns, 3000.0, None)
    assert inject.profile is not None
    assert inject.profile.gain == 2
    assert inject.profile.neutral_rows == (PERIOD_NS - 250_000) // ROW_NS


@pytest.mark.parametrize(("lasts_s", "ppm"), [(1, 300), (6_000, 14), (6_000, -300), (20, 2)])
def test_drift_crosses_the_grid_in_a_burst_and_a_recording_begins_within_the_tolerance(
    lasts_s: int, ppm: float
) -> None:
    rate, lead_ns, begins_ns = ppm * 1e-6, 200_000_000, 500_000_000
    drift = Drift(error_ns=90_000, rate=rate, period_ns=33e6, tolerance_ns=100_000, grace_ns=0)
    setpoint = setpoint_for_burst(drift, lead_ns, 0, 0, begins_ns=begins_ns, lasts_ns=lasts_s * 1e9)
    assert setpoint is not None
    first_ns = setpoint.target_ns + rate * (begins_ns - lead_ns)
    if lasts_s < 2:
        assert first_ns == pytest.approx(-rate * lasts_s * 1e9 / 2)
    else:
        assert abs(first_ns) <= max(100_000, abs(rate) * 1e9)
        assert first_ns * rate < 0, "drift crosses the grid"
