"""Poses that are pixels off are refined by points at rest, and depth says what it rests on."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from msgspec import structs

from capture_app.common.errors import NotApplicableError
from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import View, angle_deg
from reconstruction.methods.multiview import refinement
from reconstruction.methods.multiview.confidence import DepthSupport
from reconstruction.methods.multiview.multiview_method import Multiview
from reconstruction.methods.multiview.refinement import estimate_scale_error, refine_calibration, refine_views
from reconstruction.scene.calibration.consistency import (
    check_rig,
    consistent_matches,
    describe_residual,
    triangulate,
)
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.pairs import Features
from reconstruction.scene.scene import Scene
from tests.unit.reconstruction.conftest import make_view

VIEWS = {
    f"cam{k}": make_view((x, y, 0.0), yaw=-5 * x)
    for k, (x, y) in enumerate([(-0.3, 0), (-0.1, 0.05), (0.1, -0.05), (0.3, 0)])
}


def seen(count: int = 300, noise_px: float = 0.1) -> dict[str, Features]:
    """Points that all cameras see, each with a descriptor of its own."""
    rng = np.random.default_rng(3)
    points = rng.uniform((-0.8, -0.6, 2.0), (0.8, 0.6, 5.0), (count, 3))
    descriptors = rng.random((count, 128), np.float32)
    return {
        name: Features(
            view.project(points @ view.rotation.T + view.translation) + rng.normal(0, noise_px, (count, 2)),
            descriptors,
            np.ones(count),
        )
        for name, view in VIEWS.items()
    }


def spoilt(px: float) -> dict[str, View]:
    rng, found = np.random.default_rng(1), {}
    for name, view in VIEWS.items():
        rotation = cv2.Rodrigues(rng.normal(0, px / view.focal, 3))[0] @ view.rotation
        found[name] = replace(view, rotation=rotation, translation=-rotation @ view.centre)
    return found


def moved(sigma: float, seed: int) -> dict[str, View]:
    rng = np.random.default_rng(seed)
    return {
        name: replace(view, translation=-view.rotation @ (view.centre + rng.normal(0, sigma, 3)))
        for name, view in VIEWS.items()
    }


def error_px(views: dict[str, View], features: dict[str, Features]) -> float:
    found = check_rig(views, features).error_px
    assert found is not None
    return found


def depth_error(views: dict[str, View], features: dict[str, Features]) -> float:
    """The median relative error of points triangulated by the first and the last camera, as seen by it."""
    depths = []
    for of in (views, VIEWS):
        first, last = of["cam0"], of["cam3"]
        pixels = np.stack([features[name].positions for name in ("cam0", "cam3")])
        depths.append((triangulate([first, last], pixels) @ first.rotation.T + first.translation)[:, 2])
    return float(np.median(np.abs(depths[0] / depths[1] - 1)))


@pytest.mark.parametrize("px", [0.5, 2.0])
def test_poses_that_are_off_fit_again(px: float) -> None:
    views, features = spoilt(px), seen()
    assert error_px(views, features) > 0.3 * px
    refined = refine_views(views, features)
    assert error_px(refined, features) < 0.15
    assert depth_error(refined, features) < 0.01
    assert depth_error(views, features) > 0.015 * px
    spread = [np.std([view.centre for view in of.values()], axis=0) for of in (views, refined)]
    assert np.linalg.norm(spread[1]) == pytest.approx(np.linalg.norm(spread[0]), rel=1e-6)


def test_the_scale_of_refined_poses_is_as_uncertain_as_it_says() -> None:
    sigmas, sizes = [], []
    for seed in range(40):
        views = moved(0.01, seed)
        # What a refinement finds: the true shape, at the size that the moved cameras have.
        centres, true = (np.array([view.centre for view in of.values()]) for of in (views, VIEWS))
        middle, true_middle = centres.mean(0), true.mean(0)
        size = float(np.linalg.norm(centres - middle) / np.linalg.norm(true - true_middle))
        found = {
            name: replace(
                view, translation=-view.rotation @ (middle + size * (VIEWS[name].centre - true_middle))
            )
            for name, view in views.items()
        }
        sigmas.append((size - 1) / estimate_scale_error(views, found))
        sizes.append(size)
    assert np.std(sizes) > 0.01
    assert 0.8 < np.std(sigmas) < 1.3


def test_depth_of_an_uncertain_scale_is_not_sure() -> None:
    support = DepthSupport(np.array([[4.6, 4.6]]), np.array([[8.0, 0.1]]))
    sure, no_more = support.confidence(0.1)[0], support.confidence(0.1, 0.02)[0]
    assert sure[0] > 0.98
    # One standard deviation of the scale is the 2 % within which depth is right.
    assert no_more[0] == pytest.approx(0.68, abs=0.02)
    assert no_more[1] < sure[1] < 0.6


def test_a_camera_with_few_points_is_not_refined() -> None:
    few = seen()
    few["cam2"] = Features(few["cam2"].positions[:9], few["cam2"].descriptors[:9], np.ones(9))
    with pytest.raises(NotApplicableError, match="cam2 shares only"):
        refine_views(VIEWS, few)


@pytest.mark.parametrize(
    ("px", "text"),
    [
        (0.21, "points at rest fit within 0.21 px (1,200 matches); at such a misfit, 81 to 84 %"),
        (0.7, "warning: this depth is inaccurate: points at rest fit within 0.70 px"),
        (0.7, "calibrate the rig again, or try --refine"),
        (2.4, "warning: this depth is not a measurement"),
        (None, "could not be checked"),
    ],
)
def test_depth_says_what_it_rests_on(px: float | None, text: str) -> None:
    assert text in describe_residual(px, 1200)


def test_a_measured_expectation_stands_in_place_of_the_simulated_rigs() -> None:
    assert describe_residual(0.21, 1200, expected=0.915, expected_range=(0.803, 0.964)) == (
        "points at rest fit within 0.21 px (1,200 matches); "
        "92 % (80 to 96; 95 %) of the pixels are expected within 2 % of the true depth"
    )
    assert "in the mean of rigs with such a misfit" in describe_residual(0.71, 1200, expected=0.4)


def test_a_single_camera_that_does_not_fit_is_enough_for_a_warning() -> None:
    text = describe_residual(0.21, 1200, errors_px={"cam01": 0.34, "cam02": 0.2})
    start = (
        "warning: this depth is inaccurate: points at rest fit within 0.21 px, those of cam01 within 0.34 px"
    )
    assert text.startswith(f"{start} (1,200 matches);")
    assert text.endswith("calibrate the rig again, or try --refine")


def test_a_calibration_that_could_not_be_checked_has_an_expectation_too() -> None:
    assert describe_residual(None, 0, expected=0.0, expected_range=(0.0, 0.803)).endswith(
        "too few points at rest; 0 % (0 to 80; 95 %) of the pixels are expected within 2 % of the true depth"
    )
    assert describe_residual(None, 0).endswith("too few points at rest")


def test_matches_for_which_opencv_fails_an_assertion_fit_no_geometry(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_given: object) -> None:
        raise cv2.error("Assertion failed: !model.empty() in function 'setModelParameters'")

    views = make_view((0.0, 0.0, 0.0)), make_view((0.1, 0.0, 0.0))
    at = np.random.default_rng(0).uniform(20, 200, (60, 2))
    assert consistent_matches(views, at, at) is not None
    monkeypatch.setattr(cv2, "findFundamentalMat", fails)
    assert consistent_matches(views, at, at) is None


def test_depth_of_few_pixels_is_no_success() -> None:
    result = SimpleNamespace(
        views=VIEWS,
        fused_points=900,
        seconds=1.0,
        moving_measured=None,
        within_2pct=None,
        basis="",
        coverage=0.02,
        reference="cam1",
    )
    lines = [*Multiview().lines(result, Path())]
    assert lines[-2].startswith("warning: only 2 % of cam1's pixels have a depth")
    result.coverage = 0.8
    assert len([*Multiview().lines(result, Path())]) == len(lines) - 1


def test_a_scene_is_refined_by_its_own_points_and_says_so(
    trio: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap has no package for this machine")
    scene = Scene(Dataset(trio))
    true = scene.views
    turned = replace(true["left"], rotation=cv2.Rodrigues(np.array([0.01, 0, 0]))[0] @ true["left"].rotation)
    turned = replace(turned, translation=-turned.rotation @ true["left"].centre)
    wrong = scene.calibration.cameras | {"left": turned.to_calibration(), "gone": turned.to_calibration()}
    refined = refine_calibration(scene.calibrated(structs.replace(scene.calibration, cameras=wrong)))
    before, after = map(float, re.findall(r"\d+\.\d\d", refined.source))
    assert refined.source == f"boards, refined from {before:.2f} to {after:.2f} px by points at rest"
    assert before > 0.5 > 0.2 > after
    assert refined.calibration.cameras.keys() == wrong.keys()
    assert angle_deg(refined.views["left"].axis, refined.views["right"].axis) == pytest.approx(
        angle_deg(true["left"].axis, true["right"].axis), abs=0.1
    )
    assert 0 < refined.scale_error < 0.1
    bare = SimpleNamespace(given=None, dataset=SimpleNamespace(name="boards"))
    with pytest.raises(NotApplicableError, match="boards has no calibration to refine"):
        refine_calibration(bare)  # type: ignore[arg-type]
    monkeypatch.setattr(refinement, "MIN_POINTS_PER_CAMERA", 10_000)
    with pytest.raises(NotApplicableError, match="10000 are needed to refine its pose"):
        refine_calibration(scene)


def test_a_calibration_that_fits_stays_as_it_is(trio: Session) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap has no package for this machine")
    scene = Scene(Dataset(trio))
    assert refine_calibration(scene) is scene
