"""What moves is found; noise, flicker and a trembling edge are not."""

import numpy as np

from reconstruction.session.moving_pixels import detect_moving, median_background
from tests.reconstruction.conftest import Scene, make_view, texture


def test_a_moving_board_is_found_where_it_is_now(scene: Scene) -> None:
    view = make_view((0, 0, 0))
    shots = [scene.look(view, k) for k in range(7)]
    images = [image for image, _, _ in shots]
    found = detect_moving(images[3], [images[1], images[5]], median_background(images))
    true = shots[3][2]
    assert (found & true).sum() > 0.6 * true.sum()
    assert (found & ~true).sum() < 0.25 * true.sum()


def test_noise_and_flicker_do_not_move() -> None:
    rng = np.random.default_rng(5)
    still = texture(9)[:240, :320].astype(float)
    images = [
        np.clip(still + rng.normal(0, 3, still.shape) + 10 * (k % 2), 0, 255).astype(np.uint8)
        for k in range(6)
    ]
    assert not detect_moving(images[2], [images[1], images[4]], median_background(images)).any()


def test_a_trembling_camera_does_not_move_its_edges() -> None:
    bars = np.zeros((120, 160), np.uint8)
    bars[:, 40:80] = 220
    trembling = bars.astype(float)
    trembling[:, 40] = 150
    images = [bars, trembling.astype(np.uint8), bars, bars]
    assert not detect_moving(images[1], [images[0], images[2]], median_background(images)).any()
