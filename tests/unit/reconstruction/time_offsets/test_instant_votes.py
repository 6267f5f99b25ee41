"""Every instant votes by itself: dropped frames, another frame rate, and runs that disagree are told."""

from dataclasses import replace

import numpy as np
import pytest

from reconstruction.method.timing import Timing, judge_timing, with_curve_peak
from reconstruction.time_offsets import crossings as crossings_module
from reconstruction.time_offsets.crossings import Crossings, fit_offset
from reconstruction.time_offsets.instant_votes import Change, Step, Votes, count_votes, find_change
from tests.unit.reconstruction.test_timing import timing_sentences
from tests.unit.reconstruction.time_offsets.test_offset_fit import NOTHING_STILL, PERIOD_MS, crossings

INSTANTS = 24


def take(
    *jumps: tuple[int, int], drift: float = 0.0, wander_ms: float = 0.0, seed: int = 0, points: int = 12
) -> Crossings:
    """Points of each instant and wrong ones, 3; from each jump on, R is so many frames later."""
    found = crossings(0.3, right=points * INSTANTS, wrong=70, instants=INSTANTS, seed=seed)
    late_ms = drift * PERIOD_MS * (found.instant - INSTANTS / 2)
    for instant, frames in jumps:
        late_ms = late_ms + PERIOD_MS * frames * (found.instant >= instant)
    wander = np.random.default_rng(seed).uniform(-wander_ms, wander_ms, INSTANTS)
    return found.later(late_ms + wander[found.instant])


def judged(found: Crossings) -> Timing:
    return judge_timing(("L", "R"), fit_offset(found, NOTHING_STILL, PERIOD_MS), 0.0, PERIOD_MS)


@pytest.mark.parametrize(
    "jumps",
    [[(15, 1)], [(9, 1)], [(8, 1), (16, 1)], [(3, 1)], [(21, 1)], [(12, -1)], [(7, 1), (17, -1)], [(12, 2)]],
)
def test_dropped_and_repeated_frames_are_placed(jumps: list[tuple[int, int]]) -> None:
    for seed in range(3):
        found = judged(take(*jumps, seed=seed))
        assert [step.frames for step in found.change.steps] == [frames for _, frames in jumps]
        for step, (instant, _) in zip(found.change.steps, jumps, strict=True):
            assert abs(step.instant - instant) <= 1
            assert step.earliest <= step.instant <= step.latest
        assert found.offset
        assert not found.synchronized
        assert found.same_frame_ms is None
        assert found.late_ms == pytest.approx(0.3, abs=2)


def test_a_dropped_frame_is_told_with_what_to_do() -> None:
    text = timing_sentences(judged(take((15, 1))))
    assert "R is one frame later than L from instant 15 on" in text
    assert "reconstruct time --repair-drops" in text


def test_two_changes_are_told_together() -> None:
    change = Change(steps=(Step(8, 1, 8, 8), Step(20, -1, 17, 22)))
    text = "R is one frame later than L from instant 8 on, as before from instant 20 on (between 17 and 22)"
    assert change.describe("R", "L") == text


@pytest.mark.parametrize("drift", [0.05, -0.03, 0.2])
def test_another_frame_rate_is_told(drift: float) -> None:
    found = judged(take(drift=drift))
    assert found.change.drift == pytest.approx(drift, abs=max(2 * found.change.drift_sd, 1e-3))
    assert not found.change.steps
    assert found.offset
    assert found.same_frame_ms is None
    assert "R's frames last " in timing_sentences(found)


def test_a_wrong_calibration_of_cameras_that_turn_back_is_not_another_rate() -> None:
    """A fixed error across the lines is a delay of one sign before a pan turns, of the other after it."""
    since = np.arange(14) - 6.5
    late = np.clip(0.6 / since, -0.35, 0.35) + 0.01 * since
    found = crossings(0.0, right=60 * 14, wrong=0, instants=14)
    told = judged(found.later(PERIOD_MS * late[found.instant]))
    assert not told.change
    assert not told.offset
    assert not told.synchronized


@pytest.mark.parametrize(("drift", "text"), [(1 / 6, "20 ± 3 % longer"), (-0.25, "20 ± 1 % shorter")])
def test_frames_that_last_longer_are_told_by_their_own_length(drift: float, text: str) -> None:
    """A delay that grows by a sixth of the time recorded is that of frames that last a fifth longer."""
    assert Change(drift=drift, drift_sd=0.01).describe("R", "L") == f"R's frames last {text} than L's"
    assert "± 10 %" in Change(drift=drift, drift_sd=0.05 * (1 - drift) ** 2).describe("R", "L")


@pytest.mark.parametrize("wander_ms", [0.0, 6.0])
def test_what_is_steady_or_wanders_changes_nothing(wander_ms: float) -> None:
    for seed in range(4):
        found = judged(take(wander_ms=wander_ms, seed=seed))
        assert not found.change
        assert found.synchronized == (not wander_ms)


def test_a_run_that_disagrees_takes_certificate_and_frame_away() -> None:
    found = take()
    odd = found.instant >= INSTANTS - 2
    found = replace(found, offset_ms=np.where(odd, found.offset_ms + 0.7 * PERIOD_MS, found.offset_ms))
    timing = judged(found)
    assert not timing.change
    assert timing.disagreeing == (INSTANTS - 2, INSTANTS - 1)
    assert not timing.synchronized
    assert timing.same_frame_ms is None
    assert with_curve_peak(timing, dict.fromkeys(range(6), 0.0), PERIOD_MS).same_frame_ms is None


def test_two_instants_at_the_end_are_no_step_of_three_frames() -> None:
    """Where motion turns back, points cross their lines again: two instants agree on another offset."""
    assert not judged(take((INSTANTS - 2, 3), points=60)).change.steps
    assert judged(take((INSTANTS - 2, 1), points=60)).change.steps


def test_a_step_wants_instants_of_their_own_on_both_sides() -> None:
    """Of the real ball's 16 instants six showed nothing: "one frame later from instant 16 on" was false."""
    change = Change(steps=(Step(10, 1, 10, 12), Step(20, -1, 20, 20)))
    assert change.witnessed([0, 4, 10, 14, 20, 23])
    for seen in ([0, 4, 10, 14, 19], [0, 4, 20, 23], [10, 14, 20, 23]):
        assert not change.witnessed(seen)
    assert Change().witnessed([])


def test_changes_of_pairs_add_up() -> None:
    one, other = (
        Change(steps=(Step(10, 1, 9, 11),)),
        Change(steps=(Step(11, -1, 11, 12), Step(20, 1, 20, 20))),
    )
    assert one.followed_by(other).steps == (Step(20, 1, 20, 20),)
    assert not one.followed_by(one.reversed())


def test_a_frame_period_of_a_year_takes_no_more_memory() -> None:
    found = take()
    votes = count_votes(
        found.instant, found.offset_ms, np.ones(len(found.instant)), np.ones(len(found.instant))
    )
    assert not find_change(votes, period_ms=3e10)


def test_an_instant_at_which_motion_turns_does_not_disagree() -> None:
    """There, points cross their lines slowly at the common offset, and fast where they come back."""
    found = take()
    first = found.instant == 0
    back = replace(found, offset_ms=np.where(first, found.offset_ms - 2 * PERIOD_MS, found.offset_ms))
    assert judged(back).disagreeing == (0,)
    slow = found.only(first)
    slow = replace(slow, across_px_per_ms=np.full(len(slow.counts), 0.8 / PERIOD_MS))
    assert judged(Crossings.join([back, slow])).disagreeing == ()


def test_a_rate_is_not_told_by_a_calibration_that_does_not_fit() -> None:
    """A real ball, by a lens of 1.3 px at rest: "R's frames last 6.2 ± 1 % shorter than L's"."""
    found = take(drift=1.5 / INSTANTS)
    assert fit_offset(found, NOTHING_STILL, PERIOD_MS, 0.6).change.drift
    assert not fit_offset(found, NOTHING_STILL, PERIOD_MS, 1.3).change


def test_a_rate_that_is_less_than_its_error_is_not_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """A real ball that was seen well at four instants: "R's frames last 1.1 ± 20 % longer than L's"."""
    found = take(drift=0.05)
    for sd_ms, told in ((0.01 * PERIOD_MS, True), (0.1 * PERIOD_MS, False)):
        slope_ms = 0.0, sd_ms, 0.0
        monkeypatch.setattr(crossings_module, "fit_slope", lambda _, slope_ms=slope_ms: slope_ms)
        assert bool(fit_offset(found, NOTHING_STILL, PERIOD_MS).change) == told


def votes_of(peaks: dict[int, tuple[float, float]]) -> Votes:
    """The votes of instants, each with its only peak: an offset, ms, and how many."""
    offsets_ms = np.arange(-60.0, 60.5, 0.5)
    votes = np.zeros((len(peaks), len(offsets_ms)))
    for row, (at_ms, count) in enumerate(peaks.values()):
        votes[row, np.flatnonzero(offsets_ms == at_ms)] = count
    return Votes(np.array([*peaks]), offsets_ms, votes)


def test_an_instant_apart_has_a_clear_peak_of_its_own_there() -> None:
    """At 20 ms a frame, from 6 ms on; more than 3.2 times the votes beside the offset."""
    votes = votes_of({3: (0, 20), 4: (6, 6), 5: (5.5, 20), 7: (-30, 5.5), 8: (-30, 9)})
    assert votes.apart_ms(0.0, 20.0, 0.3) == {4: 6, 8: -30}
    assert votes.apart_ms(0.0, 20.0, 0.3, 9.0) == {8: -30}
    assert votes.apart_ms(6.0, 20.0, 0.3) == {3: -6, 8: -36}
    votes.votes[4, np.flatnonzero(votes.offsets_ms == 2)] = 3
    assert votes.apart_ms(0.0, 20.0, 0.3) == {4: 6}
    votes.votes[4, np.flatnonzero(votes.offsets_ms == 2)] = 2.5
    assert votes.apart_ms(0.0, 20.0, 0.3) == {4: 6, 8: -30}


def test_a_run_or_an_end_disagrees_and_one_between_others_does_not() -> None:
    steady = dict.fromkeys(range(8), (0.0, 20.0))
    assert votes_of(steady).disagreeing(0.0, 20.0) == ()
    assert votes_of(steady | {4: (20, 20)}).disagreeing(0.0, 20.0) == ()
    assert votes_of(steady | {4: (20, 20), 5: (29, 20)}).disagreeing(0.0, 20.0) == (4, 5)
    assert votes_of(steady | {4: (20, 20), 5: (30, 20)}).disagreeing(0.0, 20.0) == ()
    # An instant without a clear peak between them does not part a run.
    assert votes_of(steady | {3: (20, 20), 4: (0, 2), 5: (20, 20)}).disagreeing(0.0, 20.0) == (3, 5)
    for end in (0, 7):
        assert votes_of(steady | {end: (20, 20)}).disagreeing(0.0, 20.0) == (end,)
        assert votes_of(steady | {end: (50, 20)}).disagreeing(0.0, 20.0) == ()
    faint = steady | {6: (20, 20), 7: (0, 2)}
    assert votes_of(faint).disagreeing(0.0, 20.0) == (6,)


def test_a_changes_drift_is_about_its_pivot_and_steps_count_from_their_instants() -> None:
    change = Change(steps=(Step(10, 1, 10, 10), Step(20, -2, 20, 20)), drift=0.5, pivot=15.0)
    at_ms = change.at_ms(np.array([9, 10, 15, 19, 20]), 20.0)
    assert at_ms.tolist() == [-60, -30, 20, 60, 30]
    assert change.reversed().at_ms(np.array([9, 20]), 20.0).tolist() == [60, -30]
    assert bool(Change(drift=0.1)) is bool(Change(steps=change.steps)) is True
    assert not Change(drift_sd=1.0, pivot=9.0)
    total = Change(drift=0.1, drift_sd=0.3).followed_by(Change(drift=0.2, drift_sd=0.4, pivot=7.0))
    assert (total.drift, total.drift_sd, total.pivot) == (pytest.approx(0.3), pytest.approx(0.5), 7.0)
    assert Change(pivot=5.0).followed_by(Change(pivot=7.0)).pivot == 5.0


def test_steps_that_may_be_at_one_instant_are_added() -> None:
    first = Change(steps=(Step(10, 1, 8, 12),))
    near = first.followed_by(Change(steps=(Step(15, 1, 13, 16),)))
    assert near.steps == (Step(12, 2, 12, 13),)
    apart = first.followed_by(Change(steps=(Step(15, 1, 14, 16),)))
    assert apart.steps == (Step(10, 1, 8, 12), Step(15, 1, 14, 16))
    both = first.followed_by(Change(steps=(Step(11, 1, 10, 11),)))
    assert both.steps == (Step(10, 2, 10, 11),)


def test_changes_are_alike_whose_steps_may_be_the_same() -> None:
    change = Change(steps=(Step(10, 1, 8, 12),))
    assert change.resembles(Change(steps=(Step(13, 1, 12, 14),)))
    assert change.resembles(Change(steps=(Step(7, 1, 6, 8),)))
    for step in (Step(13, 1, 13, 14), Step(7, 1, 6, 7), Step(10, 2, 8, 12)):
        assert not change.resembles(Change(steps=(step,)))
    assert not change.resembles(Change())
    assert Change(drift=0.1).resembles(Change(drift=0.3))
    assert not Change(drift=0.1).resembles(Change(drift=-0.1))
    assert not Change(drift=0.1).resembles(Change())
