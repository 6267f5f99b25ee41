"""Parts of a pair's measurement, each with stand-ins for what it asks."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from reconstruction.common.geometry import View
from reconstruction.time_offsets import pair_offset
from reconstruction.time_offsets.crossings import Crossings, OffsetFit
from reconstruction.time_offsets.frame_jumps import BESIDE
from reconstruction.time_offsets.instant_votes import Change, Step
from reconstruction.time_offsets.pair_offset import (
    GUESSED_IN_MOTION,
    UNDETERMINED,
    PairOffsets,
    fit_in_motion,
)
from tests.unit.reconstruction.conftest import make_view

PERIOD_MS = 33.0
VIEWS = make_view((-0.2, 0, 0)), make_view((0.2, 0, 0))
OTHER = make_view((-0.2, 0, 0)), make_view((0.21, 0, 0))
STEP = Step(20, 1, 18, 22)


def finder(**parts: Any) -> PairOffsets:
    """A finder that has only these parts."""
    made = PairOffsets.__new__(PairOffsets)
    vars(made).update(parts)
    return made


def take(
    instants: int = 40,
    *,
    missing: tuple[int, ...] = (),
    unsynchronized: str = "",
    steps: Mapping[int, int] = {},
) -> Any:
    """A camera's images every 33 ms, but later by 33 ms for each of the `steps` from that instant on."""

    def time_ns(k: int) -> int:
        return 33_000_000 * (k + sum(late for at, late in steps.items() if k >= at))

    return SimpleNamespace(
        period_ns=33_000_000,
        unsynchronized=unsynchronized,
        instants=lambda camera: tuple(k for k in range(instants) if k not in missing),
        has_image=lambda camera, k: 0 <= k < instants and k not in missing,
        record=lambda camera, k: SimpleNamespace(leader_ns=time_ns(k)),
        grey=lambda camera, k: k,
    )


def test_a_step_is_placed_by_the_changes_of_both_cameras_images(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def place(step: Step, first: Any, second: Any, shift: int) -> Step:
        asked.append((sorted(first), sorted(second), shift))
        return replace_step(step)

    replace_step: Callable[[Step], Step] = lambda step: Step(step.instant + 1, step.frames, 1, 30)  # noqa: E731
    monkeypatch.setattr(pair_offset, "place_step", place)
    change = Change(steps=(STEP, Step(30, -1, 30, 30)))
    fit = OffsetFit(offset_ms=2.1 * PERIOD_MS, sd_ms=0.5, change=change)
    images = finder(dataset=take())
    monkeypatch.setattr(PairOffsets, "_changes", lambda self, camera, around: dict.fromkeys(around, 0.0))
    placed = images._placed(fit, ("L", "R"))
    assert [step.instant for step in placed.change.steps] == [21, 31]
    reach = 2 * BESIDE
    around = [*range(18 - reach, 22 + reach + 1)], [*range(30 - reach, 30 + reach + 1)]
    # From the first step on the second camera is a frame later.
    assert asked == [(around[0], around[0], 2), (around[1], around[1], 3)]
    # Images of recordings without common times may be of any two moments.
    assert finder(dataset=take(unsynchronized="their times"))._placed(fit, ("L", "R")) == fit
    unknown = OffsetFit(reason="nothing", change=change)
    assert images._placed(unknown, ("L", "R")) == unknown
    replace_step = lambda step: Step(step.instant, 0, 1, 30)  # noqa: E731
    none = images._placed(replace(fit, change=Change(steps=(STEP,))), ("L", "R"))
    assert none.offset_ms is None
    assert none.reason == (
        "R is one frame later than L from instant 20 on (between 18 and 22) by what moves, "
        "but its own pictures show no such gap"
    )


def test_changes_are_from_an_image_to_the_next_that_can_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = take(10, missing=(4,))

    def grey(camera: str, k: int) -> int:
        if k == 7:
            raise BadInputError("broken")
        return k

    dataset.grey = grey
    monkeypatch.setattr(pair_offset, "image_change", lambda before, image: before * 10 + image)
    found = finder(dataset=dataset)._changes("a", range(-1, 12))
    assert found == {1: 1, 2: 12, 3: 23, 6: 56, 9: 89}


def test_points_are_tracked_to_the_images_before_and_after_within_two_and_a_half_periods() -> None:
    near = finder(dataset=take(12, missing=(4, 8), steps={10: 2}), repeated={"a": (6,)}.__getitem__)
    assert near._neighbours("a", 2) == (1, 3)
    assert near._neighbours("a", 0) == (None, 1)
    assert near._neighbours("a", 3) == (2, 5)
    # A repeated image shows another moment; three periods are too long.
    assert near._neighbours("a", 5) == (3, 7)
    assert near._neighbours("a", 9) == (7, None)
    assert near._neighbours("a", 11) == (10, None)


@pytest.mark.parametrize(
    ("shifts", "rest", "said"),
    [
        ([], range(40), ""),
        ([(14, 15, 4.2)], range(16, 40), "by 4.2 pixels before instant 15: only instants 16 to 39"),
        (
            [(4, 5, 2.0), (30, 31, 6.25)],
            range(6, 30),
            "by 2.0 pixels before instant 5 and by 6.2 pixels before instant 31: only instants 6 to 29",
        ),
        # Its longest rest is not a third of the take: it moves all the time.
        ([(k, k + 1, 3.0) for k in range(5, 40, 10)], range(40), ""),
    ],
)
def test_a_camera_that_was_moved_is_measured_in_its_longest_rest(
    monkeypatch: pytest.MonkeyPatch, shifts: list[Any], rest: range, said: str
) -> None:
    monkeypatch.setattr(pair_offset, "find_shifts", lambda dataset, camera: shifts)
    instants, text = finder(dataset=take())._find_rest("a")
    assert [*instants] == [*rest]
    assert text == (f"a itself was moved {said} are measured" if said else "")


def test_a_recording_without_common_times_is_searched_then_measured_at_more_instants(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[Any] = []
    fit = OffsetFit(offset_ms=900.0, sd_ms=0.5)

    def measure(*pair: Any, **options: Any) -> OffsetFit:
        asked.append((pair, options))
        return fit

    activities = {"L": "activity of L", "R": "activity of R"}
    parts = {
        "measure": measure,
        "_activity": activities.__getitem__,
        "_repetitions": {"L": [0.0], "R": [700.0]}.__getitem__,
    }
    searched: list[Any] = []

    def rough(near: Callable[..., OffsetFit], *given: Any) -> Any:
        searched.append(given)
        assert near(8, rough=(1.0, 2.0)) is fit
        return 905.0, 49.5

    monkeypatch.setattr(pair_offset, "find_rough_offset", rough)
    assert finder(dataset=take(), **parts)._measure_anywhere("L", "R") is fit
    assert (asked.pop(), searched) == ((("L", "R"), {}), [])
    apart = finder(dataset=take(unsynchronized="their times"), **parts)
    assert apart._measure_anywhere("L", "R") is fit
    assert searched == [("activity of L", "activity of R", 700.0, PERIOD_MS)]
    assert asked == [(("L", "R", 8), {"rough": (1.0, 2.0)}), (("L", "R", 60), {"rough": (905.0, 49.5)})]
    # A step in its own times is no offset that could be written.
    fit = OffsetFit(offset_ms=900.0, sd_ms=0.5, change=Change(steps=(STEP,)), moved={"L": "it was moved"})
    stepped = apart._measure_anywhere("L", "R")
    assert (stepped.offset_ms, stepped.moved) == (None, {"L": "it was moved"})
    assert stepped.reason.startswith("R is one frame later than L from instant 20 on")
    assert stepped.reason.endswith(": it dropped or repeated frames")
    monkeypatch.setattr(pair_offset, "find_rough_offset", lambda *_: "the motion repeats")
    assert apart._measure_anywhere("L", "R").reason == "the motion repeats"


@pytest.mark.parametrize(
    ("votes", "whole_ms", "offset_ms", "span_ms"),
    [
        # Discs of 400 and 600 ms: the second alone, then both, also twelve hundred earlier.
        ({-200.0: 170.0, 0.0: 65.0, 400.0: 235.0, -800.0: 235.0, 1000.0: 170.0}, 0.0, 400.0, 1200.0),
        ({-200.0: 170.0, 400.0: 235.0, 1000.0: 170.0}, 0.0, 400.0, 0.0),
        # An offset of fewer points is not taken, and what all repeats has its own span.
        ({-200.0: 170.0, 0.0: 65.0, 400.0: 100.0}, 0.0, -200.0, 350.0),
        ({-200.0: 170.0, 400.0: 235.0}, 600.0, -200.0, 350.0),
    ],
)
def test_an_offset_of_one_body_gives_way_to_one_of_all_whole_periods_away(
    votes: dict[float, float], whole_ms: float, offset_ms: float, span_ms: float
) -> None:
    def measure(*pair: Any, rough: tuple[float, float] = (-200.0, 300.0), **_beside: Any) -> OffsetFit:
        near = [ms for ms in votes if abs(ms - rough[0]) < PERIOD_MS]
        if not near:
            return OffsetFit(reason="nothing agrees")
        return OffsetFit(near[0], 0.5, votes=votes[near[0]], unvoted=tuple(range(10)), repeats_ms=350.0)

    # An even turn that a short take shows stays beside its offset.
    repeats = {"L": [0.0, 398.0, 603.0], "R": [whole_ms]}.__getitem__
    fit = finder(dataset=take(100), measure=measure, _repetitions=repeats)._measure_anywhere("L", "R")
    assert (fit.offset_ms, fit.repeats_ms) == (offset_ms, span_ms)


@pytest.mark.parametrize("offset_ms", [None, 3.0])
def test_a_fit_says_which_cameras_were_moved_show_a_screen_and_repeat(offset_ms: float | None) -> None:
    parts: dict[str, Any] = {
        "_rest": {"L": ((), "L itself was moved"), "R": ((), "")}.__getitem__,
        "_screen": {"L": np.zeros(3, bool), "R": np.array([False, True, False])}.__getitem__,
        "_repetitions": {"L": [0.0, 300.0], "R": [700.0]}.__getitem__,
    }
    fit = OffsetFit(offset_ms, None if offset_ms is None else 0.5, "" if offset_ms else "nothing agrees")
    limited = finder(**parts)._limited(fit, ("L", "R"))
    assert limited.moved == {"L": "L itself was moved"}
    if offset_ms is None:
        assert limited.reason == "nothing agrees beside the screen in the pictures of R"
        parts["_screen"] = lambda camera: np.zeros(3, bool)
        assert finder(**parts)._limited(fit, ("L", "R")).reason == "nothing agrees"
        return
    assert (limited.screens, limited.repeats_ms) == (("R",), 700.0)
    parts["_repetitions"] = lambda camera: [0.0, 300.0]
    parts["_turning_ms"] = lambda camera, fit: {"L": 450.0}[camera]
    assert finder(**parts)._limited(fit, ("L", "R")).repeats_ms == 450.0


class Moving:
    """Cameras that move: how far matches are off at an offset, corrections, and the fits they give."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.off_px: dict[tuple[float, float], float] = {}
        self.corrections: dict[float, Any] = {}
        self.fits: dict[float, OffsetFit] = {}
        self.recorded_px: list[float] = []
        monkeypatch.setattr(pair_offset, "_off_px", self._off)
        monkeypatch.setattr(pair_offset, "correct_views", self._correct)
        monkeypatch.setattr(pair_offset, "fit_offset", self._fit)

    def _off(self, views: tuple[View, View], matches: Any) -> float:
        return self.off_px[views[1].centre[0], matches[2][0]]

    def _correct(self, pair: Any, at_a: Any, at_b: Any, at_ms: Any, period_ms: float) -> Any:
        assert period_ms == PERIOD_MS
        return self.corrections.get(float(at_ms[0]))

    def _fit(self, crossings: Any, still: Any, period_ms: float, recorded_px: float = 0.0) -> OffsetFit:
        assert len(still[0]) == 0
        self.recorded_px.append(recorded_px)
        return self.fits[crossings[1].centre[0]]

    def measure(self) -> OffsetFit:
        at = np.zeros((7, 2))
        cross: Any = lambda pair: pair  # noqa: E731
        crossings: Callable[[tuple[View, View]], Crossings] = cross
        return fit_in_motion(VIEWS, PERIOD_MS, crossings, lambda ms: (at, at, np.full(7, ms)))


UNKNOWN, LATE = OffsetFit(reason="too few points"), OffsetFit(offset_ms=40.0, sd_ms=0.3)


def test_a_calibration_that_fits_in_motion_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    moving = Moving(monkeypatch)
    moving.off_px = {(0.2, 0.0): 0.6, (0.2, 40.0): 1.0}
    moving.fits = {0.2: LATE}
    assert moving.measure() is LATE
    moving.fits = {0.2: UNKNOWN}
    assert moving.measure() is UNKNOWN
    # At the offset it does not fit, and no correction does.
    moving.fits, moving.off_px = {0.2: LATE}, {(0.2, 0.0): 0.5, (0.2, 40.0): 3.0}
    wrong = moving.measure()
    assert (wrong.offset_ms, wrong.misfit_px) == (None, 3.0)
    assert "7 matched points are 3.0 pixels off" in wrong.reason


def test_a_calibration_is_corrected_with_the_offset_in_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    moving = Moving(monkeypatch)
    moving.off_px = {(0.2, 0.0): 5.0, (0.2, 10.0): 4.0, (0.2, 42.0): 4.5, (0.2, 40.0): 0.9}
    moving.corrections = {0.0: (OTHER, 10.0, 0.4)}
    moving.fits = {0.21: OffsetFit(offset_ms=11.0, sd_ms=0.3)}
    fit = moving.measure()
    assert (fit.offset_ms, fit.sd_ms) == (11.0, pytest.approx(0.5))
    assert moving.recorded_px == [4.0]
    # The offset disagrees with the one that the matches were corrected by.
    moving.fits = {0.21: OffsetFit(offset_ms=11.6, sd_ms=0.3)}
    assert moving.measure().reason == "the moving points do not agree on one offset"
    moving.fits = {0.21: UNKNOWN}
    assert moving.measure() is UNKNOWN
    # More than half a frame is approached, in at most four steps.
    moving.corrections = {0.0: (OTHER, 30.0, 0.4), 30.0: (OTHER, 12.0, 0.4)}
    moving.fits = {0.21: OffsetFit(offset_ms=42.0, sd_ms=0.3)}
    assert moving.measure().offset_ms == 42.0
    # Where that does not converge, the offset of the moving points is the next start.
    moving.corrections = {0.0: (OTHER, 30.0, 0.4), 40.0: (OTHER, 2.0, 0.4)}
    moving.fits = {0.2: LATE, 0.21: OffsetFit(offset_ms=42.0, sd_ms=0.3)}
    assert moving.measure().offset_ms == 42.0
    endless = {30.0 * k: (OTHER, 30.0, 0.4) for k in range(4)}
    moving.corrections = endless | {120.0: (OTHER, 1.0, 0.4)}
    lost = moving.measure()
    assert (lost.offset_ms, lost.misfit_px) == (None, 5.0)


@pytest.mark.parametrize(
    ("doubtful", "moves", "in_plane", "reason"),
    [
        (False, True, True, ""),
        (True, True, False, GUESSED_IN_MOTION),
        (True, False, True, UNDETERMINED),
        (True, False, False, ""),
    ],
)
def test_a_guessed_calibration_shows_no_offset_where_others_fit_as_well(
    monkeypatch: pytest.MonkeyPatch, doubtful: bool, moves: bool, in_plane: bool, reason: str
) -> None:
    scene = SimpleNamespace(
        views=dict(zip("LR", VIEWS, strict=True)), lenses=SimpleNamespace(is_doubtful=doubtful)
    )
    pairs = finder(scene=scene, dataset=take())
    monkeypatch.setattr(PairOffsets, "moving", lambda self, cameras: {"L": (9.0, 33.0)} if moves else {})
    monkeypatch.setattr(PairOffsets, "_still_matches", lambda self, *cameras: cameras)
    monkeypatch.setattr(pair_offset, "fit_one_plane", lambda *at: at == ("L", "R") and in_plane)
    assert pairs._why_unmeasurable("L", "R") == reason


def test_cameras_that_move_have_no_outlines() -> None:
    """All of the picture moves in front of them; of a still camera each outline counts as four points."""
    outline = SimpleNamespace(area=np.array([90.0]), at=np.zeros((1, 2)), errors_px=np.array([0.3]))
    points = np.eye(128)[:20], np.zeros((3, 20, 2))
    parts = {
        "_points": lambda camera, k, all_moves: points,
        "_outlines": lambda camera, k: outline,
        "_path": lambda times, image, corners, objects: (image, corners.shape, len(objects)),
    }
    pairs: Any = finder(**parts)
    (first, second), counts, errors_px = pairs._paths(None, ("L", "R"), False, (3, 4))
    assert (first, second) == ((("L", 3), (3, 20, 2), 1), (("R", 4), (3, 20, 2), 1))
    assert counts.tolist() == [1.0] * 20 + [4.0]
    assert errors_px.tolist() == [0.0] * 20 + [pytest.approx(np.hypot(0.3, 0.3))]
    (first, _), counts, errors_px = pairs._paths(None, ("L", "R"), True, (3, 4))
    assert (first[2], len(counts), len(errors_px)) == (0, 20, 20)
