"""What crossings of epipolar lines agree on, among wrong matches and with a calibration that is off."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from reconstruction.method.timing import judge_timing
from reconstruction.report.findings import sentences
from reconstruction.time_offsets import crossings as crossings_module
from reconstruction.time_offsets.crossings import (
    Crossings,
    InstantOffset,
    OffsetFit,
    StillErrors,
    _fit,
    fit_offset,
    fit_slope,
    points_at_offset,
    scatter_ms,
    steps_ratio,
)
from reconstruction.time_offsets.instant_votes import Change, Step
from reconstruction.time_offsets.pair_geometry import ODDS_PX, TERMS, geometry_terms, places
from tests.unit.reconstruction.time_offsets.test_pair_geometry import A, B, seen

PERIOD_MS = 20.0
NOTHING_STILL = np.zeros(0), np.zeros((0, TERMS))


def still(shift_px: float, count: int = 300) -> StillErrors:
    """What stands still all over the picture, so far off its lines."""
    rng = np.random.default_rng(9)
    off = shift_px + rng.normal(0, 0.2, count)
    return off, geometry_terms(A, B, *seen((2.0, 5.0), count, seed=9))


def crossings(
    offset_ms: float,
    *,
    right: int = 60,
    wrong: int = 60,
    shift_px: float = 0.0,
    instants: int = 8,
    seed: int = 0,
    speeds: tuple[float, ...] = (-1, 1),
) -> Crossings:
    """Points that cross their line up- and downwards at other speeds; wrong ones cross it at any time."""
    rng = np.random.default_rng(seed)
    count = right + wrong
    speed = rng.choice(speeds, count) * rng.uniform(0.1, 0.6, count)
    found = offset_ms + (shift_px + rng.normal(0, 0.3, count)) / speed
    found[right:] = rng.uniform(-150, 150, wrong)
    geometry = geometry_terms(A, B, *seen((1.5, 6.0), count, seed=seed)) if count else np.zeros((0, TERMS))
    at, none = rng.integers(0, instants, count), np.zeros(count)
    of_b = np.where(np.arange(count) % 2, at, -1)
    return Crossings(at, found, speed, np.ones(count), none, geometry, of_b)


def test_the_error_bar_holds_the_error() -> None:
    misses = []
    for seed, offset_ms in enumerate(np.linspace(-80, 80, 30)):
        found = fit_offset(crossings(float(offset_ms), seed=seed), NOTHING_STILL, PERIOD_MS)
        assert found.offset_ms is not None, found.reason
        assert found.sd_ms is not None
        misses.append((found.offset_ms - offset_ms) / found.sd_ms)
    assert np.sqrt(np.mean(np.square(misses))) < 1.4
    assert np.max(np.abs(misses)) < 4


def test_wrong_matches_tell_no_offset_where_all_else_moves_along_its_lines() -> None:
    """A board that moves sideways before two cameras beside each other "was 66.6 ± 1.6 ms early"."""
    alike = crossings(-66.0, right=60, wrong=560)
    assert fit_offset(alike, NOTHING_STILL, PERIOD_MS).offset_ms is not None
    along = crossings(0.0, right=0, wrong=9000, seed=1)
    along = replace(along, across_px_per_ms=along.across_px_per_ms / 100)
    found = fit_offset(Crossings.join([alike, along]), NOTHING_STILL, PERIOD_MS)
    assert (found.offset_ms, found.reason) == (
        None,
        "nearly all moving points move along their epipolar lines",
    )


def test_a_calibration_that_is_off_is_no_lateness() -> None:
    found = fit_offset(crossings(5.0, shift_px=1.5), still(1.4), PERIOD_MS)
    assert found.offset_ms == pytest.approx(5.0, abs=1)
    one_way = crossings(5.0, wrong=0, shift_px=1.5, seed=1, speeds=(0.9, 1.1))
    known, unknown = (fit_offset(one_way, one, PERIOD_MS) for one in (still(1.5), NOTHING_STILL))
    assert known.offset_ms == pytest.approx(5.0, abs=1.5)
    assert known.sd_ms is not None
    assert unknown.sd_ms is not None
    # What moves one way hardly tells lateness from a calibration that is off, unless that is known.
    assert unknown.sd_ms > 1.3 * known.sd_ms


def test_a_calibration_that_does_not_fit_what_is_at_rest_measures_nothing() -> None:
    found = fit_offset(crossings(5.0, shift_px=12.8), still(12.8, 139), PERIOD_MS)
    assert found.offset_ms is None
    assert found.misfit_px == pytest.approx(12.8, abs=0.2)
    assert "139 points at rest are 12.8 pixels off their epipolar lines" in found.reason


def test_a_corrected_calibration_gives_a_larger_error_and_is_remembered() -> None:
    one_way = crossings(5.0, wrong=0, seed=1, speeds=(0.4, 0.5))
    good, corrected = (fit_offset(one_way, still(0.0, 3), PERIOD_MS, px) for px in (0.0, 8.0))
    assert good.sd_ms is not None
    assert corrected.sd_ms is not None
    assert corrected.sd_ms > good.sd_ms
    assert (good.misfit_px, corrected.misfit_px) == (None, 8.0)


def test_a_calibration_that_is_worse_at_rest_gives_a_larger_error() -> None:
    """At rest the residuals vary over the picture as no smooth error of a calibration does."""
    one_way = crossings(0.0, wrong=0, seed=1, speeds=(0.9, 1.1))
    good, geometry = still(0.0)
    bad = np.where(np.arange(len(good)) % 2, 1.6, -1.6) + good
    small, large = (fit_offset(one_way, (off, geometry), PERIOD_MS).sd_ms for off in (good, bad))
    assert small is not None
    assert large is not None
    assert large > 1.5 * small


@pytest.mark.parametrize("seed", range(8))
def test_what_an_error_of_the_geometry_can_explain_is_not_claimed(seed: int) -> None:
    """All moves at one speed but for what the place in the picture explains."""
    true = crossings(0.0, right=400, wrong=0, seed=seed, speeds=(1.0,))
    speed = 0.15 + 0.1 * true.geometry[:, 2]
    rng = np.random.default_rng(seed)
    off_px = true.geometry @ (0.5 * rng.normal(0, 1, TERMS)) + rng.normal(0, 0.2, 400)
    found = fit_offset(
        Crossings(
            true.instant, off_px / speed, speed, true.counts, true.shared_px, true.geometry, true.in_second
        ),
        NOTHING_STILL,
        33.0,
    )
    assert found.offset_ms is not None
    assert found.sd_ms is not None
    assert abs(found.offset_ms) < 2 * found.sd_ms


def test_nothing_is_said_where_nothing_agrees() -> None:
    nothing = fit_offset(crossings(0.0, right=0, wrong=0), NOTHING_STILL, PERIOD_MS)
    assert nothing.offset_ms is None
    assert "too few moving points" in nothing.reason
    chance = [
        fit_offset(crossings(0.0, right=0, wrong=120, seed=s), NOTHING_STILL, PERIOD_MS) for s in range(20)
    ]
    assert sum(found.offset_ms is not None for found in chance) <= 1
    alone = fit_offset(crossings(3.0, instants=1), NOTHING_STILL, PERIOD_MS)
    assert alone.offset_ms is None
    assert "3 are needed" in alone.reason


def test_one_instant_that_disagrees_does_not_move_the_result() -> None:
    good, late = crossings(0.0, wrong=0, instants=6), crossings(15.0, right=30, wrong=0, instants=1)
    odd = replace(late, instant=late.instant + 6)
    found = fit_offset(Crossings.join([good, odd]), still(0.0), PERIOD_MS)
    assert found.offset_ms == pytest.approx(0.0, abs=1)
    assert found.instants[-1].late_ms == pytest.approx(15.0, abs=2)


def test_crossings_of_one_point_are_one_measurement() -> None:
    """A point crosses its line in both cameras and for each other image, always with its own error."""
    few = crossings(0.0, right=60, wrong=0, instants=6)
    again = Crossings.join([few] * 4)
    once, often = (fit_offset(one, still(0.0), PERIOD_MS).instants for one in (few, again))
    for one, four in zip(once, often, strict=True):
        assert four.sd_ms == pytest.approx(one.sd_ms, rel=0.1)
        assert four.points == pytest.approx(one.points, abs=1)


def test_an_outline_of_which_a_part_is_missing_makes_its_instant_and_the_offset_less_certain() -> None:
    sharp = crossings(0.0, right=80, wrong=0, instants=8)
    rough = replace(sharp, shared_px=np.where(sharp.instant < 4, 1.5, 0.3))
    before, after = (fit_offset(one, still(0.0), PERIOD_MS) for one in (sharp, rough))
    assert before.sd_ms is not None
    assert after.sd_ms is not None
    assert after.sd_ms > 1.2 * before.sd_ms
    errors = {one.instant: one.sd_ms for one in after.instants}
    assert errors[1] > 2 * errors[6]


def test_a_geometry_that_moving_points_contradict_widens_the_error() -> None:
    """A moving rig sees nothing at rest: what its points tell of the geometry says how wrong it may be."""
    true = crossings(0.0, right=400, wrong=0, speeds=(1.0,))
    speed = 0.15 + 0.1 * true.geometry[:, 2]
    rng = np.random.default_rng(3)
    found = []
    for size in (0.3, 6.0):
        off_px = true.geometry @ (size * rng.normal(0, 1, TERMS)) + rng.normal(0, 0.2, 400)
        seen = replace(true, offset_ms=off_px / speed, across_px_per_ms=speed)
        found.append(fit_offset(seen, NOTHING_STILL, 33.0))
    small, large = found
    assert small.sd_ms is not None
    assert large.sd_ms is None or large.sd_ms > 1.5 * small.sd_ms


def test_instants_that_are_vague_confirm_nothing() -> None:
    """A wheel that turns: one instant agrees with itself, others agree by chance with what is near it."""
    sharp = crossings(0.0, wrong=0, instants=1)
    vague = [
        replace(few, instant=few.instant + later, offset_ms=np.array([-7.0, 0.5, 6.0, 8.0]))
        for later, seed in ((1, 5), (2, 6))
        for few in [crossings(0.0, right=4, wrong=0, instants=1, seed=seed)]
    ]
    found = fit_offset(Crossings.join([sharp, *vague]), still(0.0), PERIOD_MS)
    assert found.offset_ms is None
    assert "3 are needed" in found.reason


def test_other_calibrations_that_fit_widen_the_error() -> None:
    """A guess whose focal lengths may be off by a tenth and more denies nothing by itself."""
    own = tuple(InstantOffset(k, 9.0, 0.5, 20) for k in range(4))
    late = OffsetFit(9.0, 0.6, instants=own)
    other = replace(late, offset_ms=2.0, instants=tuple(structs.replace(one, late_ms=3.0) for one in own))
    found = late.under([other, late])
    assert found.sd_ms == pytest.approx(np.hypot(0.6, 7.0))
    assert [one.sd_ms for one in found.instants] == [pytest.approx(np.hypot(0.5, 6.0))] * 4
    assert judge_timing(("L", "R"), late, 0.0, PERIOD_MS).offset
    judged = judge_timing(("L", "R"), found, 0.0, PERIOD_MS)
    assert not judged.offset
    assert not judged.synchronized
    assert late.under([]) == late


def test_an_offset_or_a_change_that_another_calibration_does_not_show_is_unknown() -> None:
    late = OffsetFit(9.0, 0.6)
    stepped = replace(late, change=Change(steps=(Step(12, 1, 11, 13),)))
    beside = replace(late, change=Change(steps=(Step(14, 1, 13, 15),)))
    assert stepped.under([beside]).change == stepped.change
    for fit, other in ((late, OffsetFit(reason="nothing")), (stepped, late), (late, stepped)):
        found = fit.under([other])
        assert found.offset_ms is None
        assert "is a guess" in found.reason


def test_bodies_that_disagree_vouch_for_no_number() -> None:
    """A television of 25 pictures a second before people made "the same instant" of half a frame."""
    seen = crossings(0.0, right=400, wrong=100)
    in_corner = (places(seen.geometry) > 0).all(1)
    other = replace(seen, offset_ms=seen.offset_ms + 14.0 * in_corner)
    assert fit_offset(seen, NOTHING_STILL, PERIOD_MS).offset_ms == pytest.approx(0, abs=1)
    found = fit_offset(other, NOTHING_STILL, PERIOD_MS)
    assert found.offset_ms is None
    assert "in a part of the picture they are +14 ms off the others" in found.reason


def test_a_body_near_the_others_time_is_averaged_into_no_number() -> None:
    """People 6 ms late before a television of the cameras' own rate were 1.7 ± 1.1 ms late."""
    seen = crossings(0.0, right=4000, wrong=1000, instants=16)
    places_of = places(seen.geometry)
    at_set = (np.abs(places_of) < 0.5).all(1)
    found = fit_offset(replace(seen, offset_ms=seen.offset_ms + 6.0 * at_set), NOTHING_STILL, PERIOD_MS)
    assert found.offset_ms is None
    assert "do not agree on one offset: in a part of the picture they are" in found.reason


@pytest.mark.parametrize("readout_ms", [-25.0, 12.0, -6.0, 4.0])
def test_opposite_and_unequal_rolling_shutters_are_said_of_rows(readout_ms: float) -> None:
    seen = crossings(2.0, right=400, wrong=100)
    rows = replace(seen, offset_ms=seen.offset_ms + readout_ms * places(seen.geometry)[:, 1])
    found = fit_offset(rows, NOTHING_STILL, 1.5 * PERIOD_MS)
    assert found.rows_ms == pytest.approx(readout_ms, abs=1.5)
    assert found.offset_ms is not None
    assert found.sd_ms is not None
    assert abs(found.offset_ms - 2.0) < 3 * found.sd_ms
    timing = judge_timing(("L", "R"), found, 0.0, 1.5 * PERIOD_MS)
    assert timing.offset
    assert not timing.synchronized
    said = sentences("timing.txt", timing=timing)
    assert "their rows are of other times, and at the middle row R is" in said
    assert "R's rows are read in another direction than L's, or at another speed" in said


@pytest.mark.parametrize("shift_px", [0.0, 0.5, 2.0])
def test_one_offset_is_not_said_of_rows(shift_px: float) -> None:
    for seed in range(5):
        seen = crossings(5.0, seed=seed, shift_px=shift_px)
        assert fit_offset(seen, NOTHING_STILL, PERIOD_MS).rows_ms == 0


def test_what_is_small_shows_no_rows() -> None:
    """A ball that falls shows each row at another time: a rate is not a rolling shutter."""
    seen = crossings(2.0, right=400, wrong=0)
    geometry = seen.geometry.copy()
    geometry[:, 2] = ODDS_PX[1] * (seen.instant / 4 - 1)
    falls = replace(seen, geometry=geometry, offset_ms=seen.offset_ms + 20.0 * (seen.instant / 4 - 1))
    assert fit_offset(falls, NOTHING_STILL, PERIOD_MS).rows_ms == 0


def line(*late_ms: float, sd_ms: float = 0.5) -> tuple[InstantOffset, ...]:
    return tuple(InstantOffset(k, ms, sd_ms, 20) for k, ms in enumerate(late_ms))


def test_offsets_that_scatter_more_than_their_errors_jitter_unless_they_drift() -> None:
    zigzag = [3.0, -3, 3, -3, 3, -3]
    assert scatter_ms(line(*zigzag), PERIOD_MS) == (
        pytest.approx(np.sqrt((1.4826 * 3) ** 2 - 0.25)),
        False,
    )
    five = [3.0, -3, 0.5, -2, 2]
    assert scatter_ms(line(*five), PERIOD_MS)[0] == pytest.approx(3.7, abs=0.1)
    assert scatter_ms(line(*five[:4]), PERIOD_MS) == (None, False)
    assert scatter_ms(line(*zigzag, sd_ms=1.5), PERIOD_MS) == (None, False)
    # A twentieth of a frame is none.
    assert scatter_ms(line(*zigzag), 100.0) == (None, False)
    assert scatter_ms(line(-7, -5, -2, 2, 5, 7), PERIOD_MS) == (None, True)
    assert steps_ratio(np.ones(5)) == 2
    assert steps_ratio(np.array([1.0, -1, 1, -1])) == pytest.approx(4 / (4 / 3))


def test_instants_off_the_offset_by_four_of_their_errors_are_odd() -> None:
    fit = OffsetFit(10.0, 0.5, instants=line(10, 12.5, 11.5, 7, 10.5))
    assert fit.odd_ms(1.0) == {1: 2.5, 3: -3}
    assert fit.odd_ms(2.6) == {3: -3}
    assert OffsetFit(instants=line(3.0)).odd_ms(1.0) == {0: 3.0}


def test_jitter_is_the_scatter_of_glitches_where_they_are_many() -> None:
    zigzag = [3.0, -3, 3, -3, 3, -3]
    steady = line(*[0.0] * 20)
    glitches = dict.fromkeys((20, 22, 24, 26, 28), 20.0)
    assert OffsetFit(0.0, 0.5, instants=line(*zigzag)).jitter_ms(PERIOD_MS) == pytest.approx(4.4, abs=0.1)
    often = OffsetFit(0.0, 0.5, instants=steady, glitches_ms=({3: 20.0}, glitches))
    assert often.jitter_ms(PERIOD_MS) == pytest.approx(float(np.std([0.0] * 20 + [20.0] * 5)))
    four = {k: ms for k, ms in glitches.items() if k > 20}
    assert replace(often, glitches_ms=({}, four)).jitter_ms(PERIOD_MS) is None
    rare = replace(often, instants=line(*[0.0] * 22))
    assert rare.jitter_ms(PERIOD_MS) is None
    stepped = replace(often, change=Change(steps=(Step(9, 1, 9, 9),)))
    assert stepped.jitter_ms(PERIOD_MS) is None
    late = replace(often, offset_ms=5.0, instants=line(*[5.0] * 20))
    assert late.jitter_ms(PERIOD_MS) == often.jitter_ms(PERIOD_MS)


def test_a_fit_that_is_later_has_later_instants_and_counts_what_it_examined() -> None:
    fit = OffsetFit(10.0, 0.5, instants=line(10, 11), glitches_ms=({4: 9.0}, {5: 9.0}), disagreeing=(6,))
    seen_at = fit.examined_at(range(9))
    assert (seen_at.unvoted, seen_at.examined) == ((2, 3, 7, 8), 9)
    later = seen_at.later(-4.0)
    assert (later.offset_ms, [instant.late_ms for instant in later.instants]) == (6, [6, 7])
    unknown = OffsetFit(reason="nothing", instants=line(1.0)).later(2.0)
    assert (unknown.offset_ms, unknown.instants[0].late_ms) == (None, 3)


def test_the_slope_of_instants_is_weighted_by_their_errors() -> None:
    late = [InstantOffset(k, 2.0 * k, 0.5, 20) for k in range(5)]
    slope_ms, sd_ms, middle = fit_slope(late)
    assert (slope_ms, middle) == (pytest.approx(2), pytest.approx(2))
    assert sd_ms == pytest.approx(0.5 / np.sqrt(10))
    vague = [*late, InstantOffset(9, 500.0, 1e4, 20)]
    assert fit_slope(vague)[0] == pytest.approx(2, abs=1e-3)
    # Scatter beyond the errors widens that of the slope.
    rough = [structs.replace(one, late_ms=one.late_ms + 4 * (-1) ** one.instant) for one in late]
    assert fit_slope(rough)[1] > 5 * sd_ms


def test_points_are_moved_along_their_paths_by_less_than_an_image() -> None:
    at_a = np.array([[[0.0, 0]] * 2, [[5, 5]] * 2, [[9, 9]] * 2])
    at_b = np.array([[[0.0, 0], [np.nan, 0]], [[10, 20], [10, 20]], [[30, 20], [30, 20]]])
    times_a, times_b = (np.tile([[-20.0], [0], [20]], 2) + ms for ms in (105.0, 100.0))

    def moved(offset_ms: float) -> list[list[float]]:
        return points_at_offset((at_a, times_a), (at_b, times_b), offset_ms)[1].tolist()

    # B's image is 5 ms before A's: towards its next one, in which both points are.
    assert moved(0.0) == [[15, 20]] * 2
    assert moved(5.0) == [[10, 20]]
    assert moved(15.0) == [[5, 10]]
    assert moved(-14.0) == [[29, 20]] * 2
    assert moved(-15.0) == moved(25.0) == []
    at, _, speeds = points_at_offset((at_a, times_a), (at_b, times_b), 15.0)
    assert (at.tolist(), speeds.tolist()) == ([[5, 5]], [[0.5, 1.0]])


def test_an_unknown_offset_stays_unknown_under_other_calibrations() -> None:
    unknown = OffsetFit(reason="nothing agrees")
    assert unknown.under([OffsetFit(3.0, 0.5)]) is unknown
    own = OffsetFit(3.0, 0.5, instants=line(3, 3, 3))
    assert own.under([]) == own
    wider = own.under([OffsetFit(3.3, 0.5, instants=line(3.4, 3)), OffsetFit(2.6, 0.5)])
    assert wider.sd_ms == pytest.approx(np.hypot(0.5, 0.4))
    assert [one.sd_ms for one in wider.instants] == pytest.approx([np.hypot(0.5, 0.4), 0.5, 0.5])


def test_few_instants_estimate_their_scatter_poorly() -> None:
    """By Student's t: of nine instants more by 1.2 / 8 + 2.4 / 64."""
    count, rng = 9, np.random.default_rng(3)
    instants = np.repeat(np.arange(count), 40)
    late_ms = np.repeat(rng.normal(0, 3, count), 40)
    speed = np.tile([0.5, -0.5], 20 * count)
    terms = geometry_terms(A, B, *seen((1.5, 6.0), len(instants), seed=1))
    one, none = np.ones(len(instants)), np.zeros(len(instants))
    fit = _fit(Crossings(instants, late_ms, speed, one, none, terms, instants), NOTHING_STILL, 1.0)
    inverse = np.linalg.inv(fit.normal)
    drawn = fit._scatter(fit.weights * fit.miss * (fit.rows @ inverse[0]))
    assert fit.sd_ms == pytest.approx(drawn * (1 + 1.2 / 8 + 2.4 / 64))
    assert drawn**2 > inverse[0, 0]


def test_a_geometry_that_moves_more_than_its_prior_is_less_certain() -> None:
    """The prior's standard deviation grows to what the errors themselves show (MacKay)."""
    quiet, loud = (
        _fit(crossings(0.0, right=400, wrong=0, shift_px=px), NOTHING_STILL, 1.0) for px in (0.0, 12.0)
    )
    place = 1
    assert abs(loud.geometry[0]) > 8
    sds = [np.sqrt(np.linalg.inv(fit.normal)[place, place]) for fit in (quiet, loud)]
    assert sds[1] > 1.3 * sds[0]


def test_one_offset_of_all_rows_is_fitted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fit takes most of a pair's time; only rows with offsets of their own need further ones."""
    fit, rows_left = crossings_module._fit_offset, [0.0]
    calls: list[int] = []

    def fitted(*given: Any) -> OffsetFit:
        calls.append(len(calls))
        return replace(fit(*given), rows_ms=rows_left[min(len(calls), len(rows_left)) - 1])

    monkeypatch.setattr(crossings_module, "_fit_offset", fitted)
    steady = crossings(5.0)
    assert fit_offset(steady, NOTHING_STILL, PERIOD_MS).rows_ms == 0
    assert len(calls) == 1
    calls.clear()
    rows_left = [3.0, 1.0, 0.0]
    assert fit_offset(steady, NOTHING_STILL, PERIOD_MS).rows_ms == 4
    assert len(calls) == 3
    calls.clear()
    rows_left = [1.0]
    assert fit_offset(steady, NOTHING_STILL, PERIOD_MS).rows_ms == 4
    assert len(calls) == 4
