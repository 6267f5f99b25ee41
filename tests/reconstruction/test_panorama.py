"""Panoramas: registered on what stands still, measured before blending, refused where they fail."""

import numpy as np
import pytest

from reconstruction.calibration.features import find_points, match_points
from reconstruction.calibration.pairs import Homography, choose_panorama, choose_stereo, fit_homography
from reconstruction.panorama import pair_homography as stitch
from tests.reconstruction.conftest import HEIGHT, VIEWS, WIDTH, Scene, make_view

SIZE = (WIDTH, HEIGHT)


def test_the_overlap_fits_when_synchronized_and_not_when_offset(scene: Scene) -> None:
    first, second = make_view((-0.01, 0, 0), yaw=-9), make_view((0.01, 0, 0), yaw=9)
    a, _, moving = scene.look(first, 2)
    b = {time: scene.look(second, time) for time in (2, 4)}
    matched = match_points(find_points(a, moving), find_points(b[2][0], b[2][2]))
    flat = stitch.flat(first, matched[0]), stitch.flat(second, matched[1])
    homography = fit_homography(*flat, SIZE, SIZE)
    assert homography is not None
    registration = stitch.register(first, second, homography)
    changing = ([moving, scene.look(first, 4)[2]], [b[2][2], b[4][2]])
    misfit = {}
    for time, (image, _, mask) in b.items():
        masks = stitch.masks(registration, (moving, mask), changing)
        misfit[time] = stitch.measure(registration, a, image, *masks)
    assert misfit[2].flow_p95_px < 3
    assert misfit[4].flow_p95_px > 2 * misfit[2].flow_p95_px
    assert misfit[4].mover_flow_p95_px is not None
    assert abs(misfit[2].static_mad - misfit[4].static_mad) < 0.5
    colours = [np.dstack([image] * 3) for image in (a, b[2][0])]
    whole = stitch.compose(registration, *colours)
    assert whole.shape[1] > 1.15 * WIDTH


def test_a_degenerate_registration_is_refused() -> None:
    view = make_view((0, 0, 0))
    squeezed = np.diag([1e-4, 1e-4, 1.0])
    blown_up = np.diag([60.0, 60.0, 1.0])
    for matrix in (np.linalg.inv(blown_up), np.linalg.inv(squeezed)):
        with pytest.raises(ValueError, match=r"fit together|overlap"):
            stitch.register(view, view, Homography(matrix, 0.5, 50, 60))


def test_pairs_are_chosen_by_what_they_see(scene: Scene) -> None:
    points = {}
    for name, view in VIEWS.items():
        image, _, moving = scene.look(view, 0)
        points[name] = find_points(image, moving)
    stereo = choose_stereo(VIEWS, points)
    assert stereo.cameras == ("left", "right")
    assert "parallax" in stereo.why
    panorama = choose_panorama(points, dict.fromkeys(points, SIZE))
    assert panorama.cameras is not None
    assert "aside" in panorama.cameras


def test_no_pair_is_made_up(scene: Scene) -> None:
    points = {}
    for name, view in (("a", make_view((0, 0, 0))), ("b", make_view((0.2, 0, 0)))):
        image, _, moving = scene.look(view, 0)
        points[name] = find_points(image, moving)
    panorama = choose_panorama(points, dict.fromkeys(points, SIZE))
    assert panorama.cameras is None
    assert "same" in panorama.why
    assert choose_stereo({}, points).cameras is None
