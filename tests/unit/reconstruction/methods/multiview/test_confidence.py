"""Confidence of depth: what raises and lowers it, and that it is as high as the fraction that is right."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.reconstruction.depth_confidence import STORED, fit_all_odds, read_rooms
from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import CalibratedImage
from reconstruction.depth.plane_sweep import Surface
from reconstruction.methods.multiview import confidence
from reconstruction.methods.multiview.blank_walls import EVIDENT_COST
from reconstruction.methods.multiview.confidence import (
    ASKEW,
    ASSUMED_RESIDUAL_PX,
    BLANK_POINTS_PX,
    FREEDOM,
    ODDS,
    PAIR_POSE_FACTOR,
    POINTS_PX,
    POSE_FACTOR,
    UNSEEN_PX,
    WEIGHTS,
    DepthSupport,
    measure_support,
    measure_terms,
)
from reconstruction.methods.multiview.sweep_matcher import ViewDepth
from tests.unit.reconstruction.depth.small_views import HEIGHT, WIDTH, photo_of, view_at

INNER = slice(25, -25), slice(35, -35)


NINETY_NINE = np.log(99)
"""Evidence of a probability of 99 %."""


def seen_by(
    levels: dict[float, Array], known: Array | None = None
) -> tuple[dict[str, CalibratedImage], dict[str, list[str]], dict[str, ViewDepth]]:
    """Cameras at these places along x, all of them sources of each other, which found these inverse depths.

    `known`: where they have a depth that others confirmed; everywhere if None.
    """
    images: dict[str, CalibratedImage] = {}
    found = {}
    for x, level in levels.items():
        images[f"{x}"] = photo_of(view_at(x), np.zeros(2))[0]
        flat = np.zeros_like(level)
        depth = 1 / level if known is None else np.where(known, 1 / level, 0)
        found[f"{x}"] = ViewDepth(depth, flat, Surface(level, flat, flat, flat))
    sources = {name: [other for other in images if other != name] for name in images}
    return images, sources, found


def supports(levels: dict[float, Array], known: Array | None = None) -> list[DepthSupport]:
    """What supports the depth of the cameras of `seen_by`."""
    return [support for _, support in measure_support(*seen_by(levels, known))]


def terms(levels: dict[float, Array], known: Array | None = None) -> dict[str, Any]:
    """The terms of the first camera of `seen_by`."""
    return next(measure_terms(*seen_by(levels, known)))[1]


def wall(level: float = 0.5) -> Array:
    return np.full((HEIGHT, WIDTH), level, np.float32)


@pytest.mark.parametrize(
    ("others", "agreeing", "close"),
    [
        ((0.5, 0.5), 2, 2),
        ((0.5, 0.494), 2, 1),
        ((0.494, 0.494), 2, 0),
        ((0.5, 0.45), 1, 1),
        ((0.45, 0.45), 0, 0),
    ],
)
def test_terms_are_the_fractions_of_views_that_agree_and_agree_closely(
    others: tuple[float, float], agreeing: int, close: int
) -> None:
    here = terms({0.0: wall(), -0.1: wall(others[0]), 0.1: wall(others[1])})
    assert here["agreeing"][INNER] == pytest.approx(agreeing / 2.25)
    assert here["close"][INNER] == pytest.approx(close / 2.25)


def test_views_that_cannot_see_a_surface_do_not_count() -> None:
    hidden = wall()
    hidden[:, :] = 0.8
    here = terms({0.0: wall(), -0.1: wall(), 0.1: hidden})
    assert here["agreeing"][INNER] == pytest.approx(1 / 1.25)
    # Beyond the right picture's left end only the left camera sees.
    assert terms({0.0: wall(), 3.0: wall()})["agreeing"][INNER].max() == 0


def test_depth_that_more_views_confirm_has_more_evidence() -> None:
    agreed, contradicted, denied = (
        supports({0.0: wall(), -0.1: wall(a), 0.1: wall(b)})[0].evidence[INNER]
        for a, b in ((0.5, 0.5), (0.5, 0.45), (0.45, 0.45))
    )
    assert (agreed > contradicted).all()
    assert (contradicted > denied).all()


def test_depth_beside_an_edge_has_less_evidence() -> None:
    level = wall()
    level[:, WIDTH // 2 :] = 0.6
    evidence = supports({0.0: level, 0.1: level})[0].evidence[HEIGHT // 2]
    edge, beyond = WIDTH // 2, WIDTH // 2 + 12
    assert evidence[edge] < evidence[beyond] - 0.5
    # As a jump of 4 % is none, a slope has no edges.
    slope = np.broadcast_to(np.linspace(0.5, 0.6, WIDTH, dtype=np.float32), (HEIGHT, WIDTH)).copy()
    middle = supports({0.0: slope, 0.1: slope})[0].evidence[HEIGHT // 2]
    assert middle[edge] > evidence[edge] + 0.2


def test_depth_in_front_of_another_surface_is_told_from_that_behind_it() -> None:
    # Windows widen objects: what they add has the object's depth.
    level = wall()
    level[:, WIDTH // 2 :] = 0.6
    in_front = terms({0.0: level, 0.01: level})["in_front"][HEIGHT // 2]
    assert (in_front[WIDTH // 2 - 7], in_front[WIDTH // 2 + 6]) == (0, 1)


def test_depth_among_holes_has_less_evidence() -> None:
    known = np.ones((HEIGHT, WIDTH), bool)
    known[::3] = False
    whole, holed = (supports({0.0: wall(), 0.1: wall()}, seen)[0].evidence[INNER] for seen in (None, known))
    assert holed == pytest.approx(whole + WEIGHTS["holes"] / 3, abs=1e-3)
    assert WEIGHTS["holes"] < 0


def test_depth_that_differs_from_its_neighbours_has_less_evidence() -> None:
    level = wall()
    level[HEIGHT // 2, WIDTH // 2] = 0.495
    here = terms({0.0: level, 0.1: level})
    # 1 % off: half of the weight, and the other view does not agree closely.
    at, beside = (HEIGHT // 2, WIDTH // 2), (HEIGHT // 2, WIDTH // 2 - 12)
    assert (here["uneven"][at], here["uneven"][beside]) == pytest.approx((0.5, 0), abs=1e-3)
    assert (here["close"][at], here["close"][beside]) == pytest.approx((0, 0.8))
    evidence = supports({0.0: level, 0.1: level})[0].evidence
    assert evidence[at] < evidence[beside] - 0.2


def seen_in(grey: Array, cost: float = 0.6, x: float = 0.1, noise: float = 9.0) -> Any:
    """What is known of the first of two cameras whose images are these: its terms, and its support."""
    images, sources, depths = seen_by({0.0: wall(), x: wall()})
    images = {name: replace(image, grey=grey, noise=noise) for name, image in images.items()}
    for name, view in depths.items():
        depths[name] = replace(view, surface=view.surface._replace(cost=np.full_like(grey, cost)))
    seen = images, sources, depths
    return next(measure_terms(*seen))[1], next(measure_support(*seen))[1]


def test_depth_is_carried_over_blank_areas_that_no_evident_plane_explains() -> None:
    blank, detailed = np.full((HEIGHT, WIDTH), 90, np.float32), photo_of(view_at(0.0), np.zeros(2))[0].grey
    half = np.where(np.arange(WIDTH) < WIDTH // 2, blank, detailed)
    carried, laid, partly, none = (
        seen_in(*case)[0]["all_carried"] for case in ((blank,), (blank, EVIDENT_COST), (half,), (detailed,))
    )
    assert (carried, laid) == (1, 0)
    assert none < 0.05
    assert partly == pytest.approx(0.5, abs=0.03)
    assert WEIGHTS["all_carried"] < 0


def test_detail_shows_depth_by_its_contrast_to_the_noise_and_by_the_baseline() -> None:
    # A ramp of one grey level a pixel, seen by two cameras: 225 gradients of signal to noise 1 / sigma.
    ramp = np.broadcast_to(np.arange(WIDTH, dtype=np.float32), (HEIGHT, WIDTH)).copy()
    moved_px, variance = 0.02 * 110 * 0.1 / 2, 0.25
    shown = 225 * (1 - variance) * moved_px**2 / (4 * variance)
    terms, _ = seen_in(ramp, noise=9 * variance)
    assert terms["all_detailed"] == pytest.approx(shown / (shown + 1), abs=0.02)
    noisy, wide = (
        seen_in(ramp, **other)[0]["all_detailed"]
        for other in ({"noise": 8.0}, {"x": 0.2, "noise": 9 * variance})
    )
    assert noisy < terms["all_detailed"] - 0.2
    assert wide > terms["all_detailed"] + 0.1
    assert WEIGHTS["all_detailed"] > 0


def test_points_of_a_blank_image_fit_a_perfect_calibration_worse() -> None:
    blank, detailed = np.full((HEIGHT, WIDTH), 90, np.float32), photo_of(view_at(0.0), np.zeros(2))[0].grey
    plain, rich = (seen_in(grey)[1] for grey in (blank, detailed))
    assert (plain.points_px, rich.points_px) == pytest.approx(
        (POINTS_PX + BLANK_POINTS_PX, POINTS_PX), abs=0.01
    )
    # The same misfit tells of a turned camera in the one, and of faint points in the other.
    assert plain.measurable(0.25).mean() > rich.measurable(0.25).mean() + 0.1


def test_a_surface_beyond_infinity_has_evidence_that_is_a_number() -> None:
    level = wall()
    level[HEIGHT // 2, WIDTH // 2] = -0.01
    assert np.isfinite(supports({0.0: level, 0.1: wall()})[0].evidence).all()


def test_two_percent_are_worth_what_the_widest_baseline_moves() -> None:
    near, wide = (supports({0.0: wall(), x: wall()})[0].worth_px[INNER] for x in (0.05, 0.2))
    # A point at 2 m moves by focal length x baseline / depth: 2 % of that.
    assert near == pytest.approx(0.02 * 110 * 0.05 / 2, rel=1e-3)
    assert wide == pytest.approx(0.02 * 110 * 0.2 / 2, rel=1e-3)
    both = supports({0.0: wall(), 0.05: wall(), 0.2: wall()})[0].worth_px[INNER]
    assert both == pytest.approx(wide)


def test_turns_cancel_in_the_middle_of_a_row_not_at_its_end() -> None:
    """Least squares of simulated shifts of all cameras; the middle one has motions to both sides."""
    row = supports({0.1 * k: wall() for k in range(5)})
    places, shifts = np.arange(5.0), np.random.default_rng(0).normal(0, 1, (4000, 5))
    for at in (0, 2):
        ways = places - at
        errors = (shifts - shifts[:, [at]]) @ ways / (ways**2).sum() * np.abs(ways).max()
        assert np.median(np.asarray(row[at].rotation_gain)[INNER]) == pytest.approx(errors.std(), rel=0.05)


def test_confidence_falls_with_the_misfit_and_rises_with_the_baseline() -> None:
    def sure(worth_px: float, misfit_px: float | None, evidence: float = NINETY_NINE) -> float:
        support = DepthSupport(np.array(evidence), np.array(worth_px), cameras=1000)
        return float(support.confidence(misfit_px))

    assert sure(4.0, 0.1) == pytest.approx(0.99, abs=0.001)
    # One standard deviation.
    assert sure(UNSEEN_PX, 0.0) == pytest.approx(0.683, abs=0.001)
    assert sure(UNSEEN_PX, POINTS_PX) == pytest.approx(0.683, abs=0.001)
    excess = 0.5**2 - POINTS_PX**2
    off_px = float(np.linalg.norm([UNSEEN_PX, POSE_FACTOR * np.sqrt(2 * excess), ASKEW * excess]))
    assert sure(off_px, 0.5) == pytest.approx(0.683, abs=0.001)
    assert sure(0.5, None) == sure(0.5, ASSUMED_RESIDUAL_PX)
    assert sure(1.0, 2.0) < sure(1.0, 0.5) < sure(1.0, 0.15)
    assert sure(4.0, 0.1, -1.0) < sure(4.0, 0.1, 1.0) < sure(4.0, 0.1, 3.0)


@pytest.mark.parametrize("cameras", [2, 3, 5])
@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_few_cameras_know_less_of_the_errors_that_points_do_not_show(
    monkeypatch: pytest.MonkeyPatch, cameras: int, ratio: float
) -> None:
    """As many errors along epipolar lines are small enough as are said to be, whatever their size is."""
    rng, freedom = np.random.default_rng(0), FREEDOM * (cameras - 1)
    misfits_px, hidden_px = np.sqrt(rng.chisquare(freedom, 20_000) / freedom), abs(rng.normal(0, 1, 20_000))
    factor = (PAIR_POSE_FACTOR if cameras == 2 else POSE_FACTOR) * np.sqrt(2)
    monkeypatch.setattr(confidence, "ASKEW", 0.0)
    said = DepthSupport(np.array(NINETY_NINE), np.array(20 * factor * ratio), cameras).measurable(20.0)
    # Wallace's formula is rough for less than one degree of freedom.
    assert float(said) == pytest.approx((hidden_px < ratio * misfits_px).mean(), abs=0.04)


MATCHED_AND_RIGHT = [
    # Studio, plain room, attic and blank room, turned by 0.5 px; attic and studio by 1 px.
    (3, (0.89, 0.49, 0.60, 0.39), 0.79, 0.50, 0.489),
    (3, (1.21, 0.47, 0.38, 0.35), 0.73, 0.43, 0.383),
    (3, (1.10, 0.47, 0.46, 0.47), 0.77, 0.79, 0.446),
    (3, (1.02, 0.61, 0.23, 0.31), 0.67, 0.40, 0.329),
    (3, (2.16, 0.88, 0.85, 0.87), 0.71, 0.78, 0.239),
    (3, (1.77, 0.96, 1.22, 0.74), 0.74, 0.50, 0.206),
    # The same with five cameras; last a row of five turned by 2 px, and a plain room and two by 1 px.
    (5, (0.87, 0.39, 0.63), 0.80, 0.65, 0.506),
    (5, (1.08, 0.43, 0.62), 0.81, 0.68, 0.558),
    (5, (0.95, 0.39, 0.55), 0.84, 1.34, 0.556),
    (5, (1.13, 0.38, 0.61), 0.76, 0.73, 0.469),
    (5, (1.86, 0.69), 0.79, 1.31, 0.447),
    (5, (1.73, 0.75), 0.75, 0.62, 0.250),
    (5, (1.79, 2.14, 1.30), 0.85, 0.99, 0.123),
    (2, (2.64, 0.94, 0.15), 0.85, 0.31, 0.047),
]
"""Cameras, misfits of draws, fraction of right matches, what 2 % are worth, px, and which fraction was right,
measured by `make bench NAME=confidence` at a width of 320 px."""


def test_turned_cameras_measure_as_many_right_matches_as_they_are_said_to() -> None:
    off = []
    for cameras, misfits_px, matched, worth_px, right in MATCHED_AND_RIGHT:
        gain = np.sqrt(2) if cameras == 2 else 1.24  # the mean of a row's cameras
        support = DepthSupport(np.array(0.0), np.array(worth_px), cameras, gain)
        off.append(matched * np.mean([support.measurable(misfit_px) for misfit_px in misfits_px]) - right)
    assert np.abs(off).max() < 0.18  # few draws of few poses
    assert abs(np.mean(off)) < 0.02
    assert np.sqrt(np.mean(np.square(off))) < 0.08


def test_the_support_of_a_view_knows_the_cameras_of_its_rig() -> None:
    assert [support.cameras for support in supports({0.0: wall(), 0.1: wall(), 0.2: wall()})] == [3, 3, 3]


def test_maps_without_a_surface_have_no_confidence() -> None:
    images = {"left": photo_of(view_at(0.0), np.zeros(2))[0]}
    assert not list(measure_support(images, {"left": []}, {"left": ViewDepth(wall(), wall())}))


def odds(part: float) -> float:
    """Odds of a probability."""
    return part / (1 - part)


def test_what_is_expected_has_an_interval_of_odds_in_the_pixels_with_depth() -> None:
    support = DepthSupport(np.array([-1.0, 0.5, 2.0, 9.0]), np.full(4, 8.0), 5)
    for residual_px, checked in ((0.1, "checked"), (0.3, "misfit"), (None, "not checked")):
        mean = float(support.confidence(residual_px)[:3].mean())
        whole = support.expected_range(np.array([True, True, True, False]), residual_px)
        assert [odds(end / 0.75) / odds(mean) for end in whole] == pytest.approx(ODDS[checked], rel=0.01)
        assert whole[0] < 0.75 * mean < whole[1] < 0.75
    assert support.expected_range(np.zeros(4, bool), 0.1) == (0, 0)
    sure = DepthSupport(np.full(1, 60.0), np.full(1, 1e3), 1000)
    assert sure.expected_range(np.ones(1, bool), 0.08) == (1, 1)


def test_the_interval_of_two_cameras_is_also_that_of_a_turn() -> None:
    support, known = DepthSupport(np.full(3, 2.0), np.array([0.4, 0.8, 4.0]), 2), np.ones(3, bool)
    ends = [float(end.mean()) for end in support.confidence_if_turned(0.1)]
    told = support.expected_range(known, 0.1)
    assert [odds(end) for end in told] == pytest.approx(
        [odds(end) * factor for end, factor in zip(ends, ODDS["checked"], strict=True)], rel=0.01
    )


def test_the_interval_is_that_of_the_stored_rooms() -> None:
    """Factors of the odds that another 95 % of rooms are between."""
    assert fit_all_odds(read_rooms(STORED)) == ODDS


def test_two_cameras_are_never_surer_than_an_unseen_turn_allows() -> None:
    """A turn sideways by half a pixel left 35 % right of 83 % that were said; a third camera shows it."""
    worth_px = np.array([0.25, 0.5, 1.0, 4.0])
    two, three = (
        DepthSupport(np.full(4, NINETY_NINE), worth_px, cameras).measurable(0.05) for cameras in (2, 3)
    )
    assert two[:3] == pytest.approx([0.57, 0.88, 0.998], abs=0.02)
    assert (two[:3] < three[:3]).all()
    low, high = DepthSupport(np.full(4, NINETY_NINE), worth_px, 2).confidence_if_turned(0.05)
    assert low.tolist() == [0, 0, 0, high[3]]
    assert high == pytest.approx(np.minimum(0.99, three))
    assert two[3] > 0.999


def test_the_range_of_two_cameras_reaches_what_turned_ones_have_right() -> None:
    """Misfit, evidence, worth of 2 % (px) and right fraction: studio and a square, turned by 0.25 px."""
    for misfit_px, evidence, worth_px, right in ((0.27, 2.00, 0.25, 0.649), (0.29, 2.47, 0.80, 0.882)):
        support = DepthSupport(np.array(evidence), np.array(worth_px), 2)
        assert support.confidence_if_turned(misfit_px)[1] > right - 0.12
