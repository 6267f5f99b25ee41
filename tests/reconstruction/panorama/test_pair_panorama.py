"""Panoramas: registered on what stands still, measured before blending, refused where they fail."""

import numpy as np
import pytest

from reconstruction.pairs.features import detect_features, match_features
from reconstruction.pairs.homography import Homography, fit_homography
from reconstruction.pairs.pair_choice import choose_panorama_pair, choose_stereo_pair
from reconstruction.panorama.pair_panorama import (
    blend_pair,
    measure_misfit,
    panorama_masks,
    register_pair,
    undistort_pixels,
)
from reconstruction.scores.results import PanoramaScores
from reconstruction.scores.tally import Tally
from tests.reconstruction.conftest import HEIGHT, VIEWS, WIDTH, Scene, make_view

SIZE = (WIDTH, HEIGHT)


def test_the_overlap_fits_when_synchronized_and_not_when_offset(scene: Scene) -> None:
    first, second = make_view((-0.01, 0, 0), yaw=-9), make_view((0.01, 0, 0), yaw=9)
    a, _, moving = scene.look(first, 2)
    b = {time: scene.look(second, time) for time in (2, 4)}
    matched = match_features(detect_features(a, moving), detect_features(b[2][0], b[2][2]))
    flat = undistort_pixels(first, matched[0]), undistort_pixels(second, matched[1])
    homography = fit_homography(*flat, SIZE, SIZE)
    assert homography is not None
    registration = register_pair(first, second, homography)
    changing = ([moving, scene.look(first, 4)[2]], [b[2][2], b[4][2]])
    misfit = {}
    for time, (image, _, mask) in b.items():
        masks = panorama_masks(registration, (moving, mask), changing)
        measured = measure_misfit(registration, a, image, *masks)
        misfit[time] = Tally([measured]).scores(PanoramaScores)
    assert misfit[2].overlap_flow_p95_px < 3
    assert misfit[4].overlap_flow_p95_px > 2 * misfit[2].overlap_flow_p95_px
    assert misfit[4].mover_flow_p95_px is not None
    assert abs(misfit[2].static_overlap_mad - misfit[4].static_overlap_mad) < 0.5
    colours = [np.dstack([image] * 3) for image in (a, b[2][0])]
    whole = blend_pair(registration, *colours)
    assert whole.shape[1] > 1.15 * WIDTH


def test_a_degenerate_registration_is_refused() -> None:
    view = make_view((0, 0, 0))
    squeezed = np.diag([1e-4, 1e-4, 1.0])
    blown_up = np.diag([60.0, 60.0, 1.0])
    for matrix in (np.linalg.inv(blown_up), np.linalg.inv(squeezed)):
        with pytest.raises(ValueError, match=r"fit together|overlap"):
            register_pair(view, view, Homography(matrix, 0.5, 50, 60))


def test_pairs_are_chosen_by_what_they_see(scene: Scene) -> None:
    points = {}
    for name, view in VIEWS.items():
        image, _, moving = scene.look(view, 0)
        points[name] = detect_features(image, moving)
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
        points[name] = detect_features(image, moving)
    panorama = choose_panorama_pair(points, dict.fromkeys(points, SIZE))
    assert panorama.cameras is None
    assert "same" in panorama.why
    assert choose_stereo_pair({}, points).cameras is None
