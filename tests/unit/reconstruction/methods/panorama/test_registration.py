"""Panoramas of two cameras: registered on what stands still, measured before blending."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from reconstruction.common.geometry import Array, View
from reconstruction.methods.panorama.composition import Projection
from reconstruction.methods.panorama.overlap import known, measure_misalignment, overlap_of
from reconstruction.methods.panorama.registration import (
    PanoramaStitcher,
    register_images,
    register_pictures,
)
from reconstruction.scene.pairs import Features, choose_panorama_pair, choose_stereo_pair, detect_features
from tests.unit.reconstruction.conftest import HEIGHT, VIEWS, WIDTH, Scene, make_view

SIZE = (WIDTH, HEIGHT)
FIRST, SECOND = make_view((-0.01, 0, 0), yaw=-9), make_view((0.01, 0, 0), yaw=9)


def picture(scene: Scene, view: View, time: float) -> tuple[Array, Array]:
    """A BGR picture and its movers."""
    grey, _, movers = scene.look(view, time)
    return np.dstack([grey] * 3), movers


def stitched(scene: Scene, first: View, second: View, *, calibrated: bool) -> PanoramaStitcher:
    seen = {name: picture(scene, view, 2) for name, view in (("a", first), ("b", second))}
    views = {"a": first, "b": second} if calibrated else {}
    return register_images(
        {name: image for name, (image, _) in seen.items()},
        {name: mask for name, (_, mask) in seen.items()},
        views,
    )


@pytest.mark.parametrize("calibrated", [True, False])
def test_the_overlap_fits_when_synchronized_and_what_moves_does_not_when_offset(
    scene: Scene, calibrated: bool
) -> None:
    stitcher = stitched(scene, FIRST, SECOND, calibrated=calibrated)
    image, moving = picture(scene, FIRST, 2)
    misfit = {}
    for time in (2, 4):
        layers = stitcher.layers({"a": image, "b": picture(scene, SECOND, time)[0]})
        overlap = overlap_of(layers["a"], layers["b"])
        assert overlap is not None
        mask = overlap.crop(stitcher.layer_mask("a", moving), layers["a"].box)
        (x, y), length = measure_misalignment(overlap.with_brightness_matched())
        on_movers = known(length[mask[y, x]])
        misfit[time] = float(np.median(known(length)))
        if time == 2:
            assert len(on_movers) > 10
            assert np.median(on_movers) < 2
        else:
            assert len(on_movers) == 0 or np.median(on_movers) > 5
        assert len(known(length)) > 30
        assert misfit[time] < 0.7
        whole = stitcher.compose(layers)
        assert whole.shape[1] > 1.15 * WIDTH
        assert (whole.max(2) > 0).mean() > 0.9


def test_a_lens_is_undone_where_it_is_known(scene: Scene) -> None:
    bent = tuple(replace(view, distortion=np.array([-0.25, 0.05, 0, 0, 0])) for view in (FIRST, SECOND))
    image = {"a": picture(scene, bent[0], 2)[0], "b": picture(scene, bent[1], 2)[0]}
    misfit = {}
    for calibrated in (True, False):
        layers = stitched(scene, *bent, calibrated=calibrated).layers(image)
        overlap = overlap_of(layers["a"], layers["b"])
        assert overlap is not None
        misfit[calibrated] = float(np.percentile(known(measure_misalignment(overlap)[1]), 75))
    assert misfit[True] < 0.7
    assert misfit[True] < 0.7 * misfit[False]


def test_a_panorama_without_a_sensible_size_is_refused() -> None:
    view = make_view((0, 0, 0))
    with pytest.raises(ValueError, match="fit together"):
        Projection(
            {"a": view, "b": replace(view, matrix=np.diag([9000.0, 9000.0, 1.0]), rotation=-np.eye(3))}
        )


def test_a_blank_overlap_has_no_misfit(scene: Scene) -> None:
    stitcher = stitched(scene, FIRST, SECOND, calibrated=True)
    blank = np.full((HEIGHT, WIDTH, 3), 120, np.uint8)
    noise = np.random.default_rng(1)
    layers = stitcher.layers(
        {name: blank + noise.integers(0, 6, blank.shape, np.uint8) for name in ("a", "b")}
    )
    overlap = overlap_of(layers["a"], layers["b"])
    assert overlap is not None
    assert len(measure_misalignment(overlap)[1]) == 0


def test_pairs_are_chosen_by_what_they_see(scene: Scene) -> None:
    points = {}
    for name, view in VIEWS.items():
        image, _, moving = scene.look(view, 0)
        points[name] = detect_features(image).at_rest(moving)
    stereo = choose_stereo_pair(VIEWS, points)
    assert stereo.cameras == ("left", "right")
    assert "parallax" in stereo.why
    panorama = choose_panorama_pair(points, dict.fromkeys(points, SIZE))
    assert panorama.cameras is not None
    assert "aside" in panorama.cameras


def test_no_pair_is_made_up(scene: Scene) -> None:
    points = {}
    for name, view in (("a", make_view((0, 0, 0))), ("b", make_view((0.2, 0, 0)))):
        image, _, moving = scene.look(view, 0)
        points[name] = detect_features(image).at_rest(moving)
    panorama = choose_panorama_pair(points, dict.fromkeys(points, SIZE))
    assert panorama.cameras is None
    assert "same" in panorama.why
    assert choose_stereo_pair({}, points).cameras is None


def test_a_calibration_that_rejects_what_cameras_share_is_the_reason() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform((-1, -1, 3), (1, 1, 6), (139, 3))
    descriptors = rng.normal(0, 1, (139, 128)).astype(np.float32)
    seen = {
        name: Features(view.project(points @ view.rotation.T + view.translation), descriptors, np.ones(139))
        for name, view in VIEWS.items()
    }
    pair = {name: VIEWS[name] for name in ("left", "right")}
    assert choose_stereo_pair(pair, seen).cameras is not None
    tilted = pair["right"].rotation @ cv2.Rodrigues(np.array([0.06, 0.0, 0.0]))[0]
    wrong = choose_stereo_pair(pair | {"right": replace(pair["right"], rotation=tilted)}, seen)
    assert wrong.cameras is None
    assert "left and right have 139 points at rest in common" in wrong.why
    assert "the calibration does not fit the pictures" in wrong.why


def test_it_is_said_whether_pictures_show_other_things_or_are_from_other_places() -> None:
    rng = np.random.default_rng(0)
    sizes = {"a": SIZE, "b": SIZE}

    def points(at: Array) -> Features:
        return Features(at.astype(np.float32), described, np.ones(len(at)))

    described = rng.random((200, 128)).astype(np.float32)
    # Points at depths of all kinds, seen from places one metre apart, and the same in any order.
    depth = rng.uniform(1.5, 6, 200)
    at = rng.uniform((0, 0), SIZE, (200, 2))
    beside = at + np.column_stack([300 / depth, np.zeros(200)])
    with pytest.raises(ValueError, match="places too far apart"):
        register_pictures({"a": points(at), "b": points(beside)}, sizes, {})
    with pytest.raises(ValueError, match="no two pictures show the same things"):
        register_pictures({"a": points(at), "b": points(rng.permutation(at))}, sizes, {})
