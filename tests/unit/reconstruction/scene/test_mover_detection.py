"""What moves is found; noise, flicker and a trembling edge are not."""

from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from reconstruction.common.geometry import Array
from reconstruction.common.image_matching import track_there_and_back
from reconstruction.scene import moving_pixels
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.moving_pixels import SceneMotion, detect_moving, in_light_of, median_background
from tests.unit.reconstruction.conftest import Scene, make_view, texture


def test_a_moving_board_is_found_where_it_is_now(scene: Scene) -> None:
    view = make_view((0, 0, 0))
    shots = [scene.look(view, k) for k in range(7)]
    images = [image for image, _, _ in shots]
    found = detect_moving(images[3], [images[1], images[5]], median_background(images))
    true = shots[3][2]
    assert (found & true).sum() > 0.6 * true.sum()
    assert (found & ~true).sum() < 0.25 * true.sum()


def test_motion_is_detected_beside_a_broken_image(scene: Scene) -> None:
    view = make_view((0, 0, 0))
    shots = [scene.look(view, k) for k in range(5)]

    def grey(camera: str, instant: int) -> Array:
        if instant == 3:
            raise BadInputError("the image is broken", hint="restore it")
        return shots[instant][0]

    dataset = SimpleNamespace(
        instants=lambda camera: range(5), grey=grey, size=lambda camera: (view.width, view.height)
    )
    found = SceneMotion(cast(Dataset, dataset), 1).detected_moving("a", 2)
    true = shots[2][2]
    assert (found & true).sum() > 0.6 * true.sum()


def test_noise_and_flicker_do_not_move() -> None:
    rng = np.random.default_rng(5)
    still = texture(9)[:240, :320].astype(float)
    images = [
        np.clip(still + rng.normal(0, 3, still.shape) + 10 * (k % 2), 0, 255).astype(np.uint8)
        for k in range(6)
    ]
    assert not detect_moving(images[2], [images[1], images[4]], median_background(images)).any()


@pytest.mark.parametrize("bands", [0.0, 2.0], ids=["lamp", "mains"])
def test_a_lamp_that_flickers_hides_nothing_that_moves(scene: Scene, bands: float) -> None:
    """By 12 % of the light in all rows at once, or in bands of a rolling shutter."""
    view = make_view((0, 0, 0))
    shots = [scene.look(view, k) for k in range(7)]
    rows = np.linspace(0, 2 * np.pi * bands, view.height)[:, None]
    images = [
        np.clip(image * (1 + 0.12 * np.sin(rows + 2 * k)), 0, 255).astype(np.uint8)
        for k, (image, _, _) in enumerate(shots)
    ]
    found = detect_moving(images[3], [images[1], images[5]], median_background(images))
    true = shots[3][2]
    assert (found & true).sum() > 0.55 * true.sum()
    assert (found & ~true).sum() < 0.25 * true.sum()


@pytest.mark.parametrize("gain", [0.8, 1.2])
def test_a_saturated_window_does_not_move_in_light_that_flickers(gain: float) -> None:
    still = texture(9)[:240, :320].astype(float)
    still[60:160, 100:220] = 300
    images = [np.clip(still * g, 0, 255).astype(np.uint8) for g in (1, 1, 1, gain, 1, 1)]
    assert not detect_moving(images[3], [images[1], images[5]], median_background(images)).any()
    assert not detect_moving(images[1], [images[0], images[3]], median_background(images)).any()


def test_light_that_did_not_change_changes_no_image(scene: Scene) -> None:
    view = make_view((0, 0, 0))
    (image, _, _), (other, _, _) = (scene.look(view, k) for k in (1, 3))
    assert in_light_of(image, other) is other


def test_a_trembling_camera_does_not_move_its_edges() -> None:
    bars = np.zeros((120, 160), np.uint8)
    bars[:, 40:80] = 220
    trembling = bars.astype(float)
    trembling[:, 40] = 150
    images = [bars, trembling.astype(np.uint8), bars, bars]
    assert not detect_moving(images[1], [images[0], images[2]], median_background(images)).any()


def test_large_images_are_tracked_small_and_their_motion_told_in_their_own_pixels(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen = []

    def tracked(before: Array, *arguments: Any) -> Any:
        seen.append(before.shape)
        return track_there_and_back(before, *arguments)

    monkeypatch.setattr(moving_pixels, "track_there_and_back", tracked)
    rng = np.random.default_rng(6)
    wide = cv2.resize(rng.integers(0, 255, (90, 170)).astype(np.uint8), (1360, 720))
    motions = moving_pixels._cell_motions(wide[:, :1280], wide[:, 12:1292])
    assert seen == [(360, 640)]
    assert len(motions) > 10
    assert np.median(motions) == pytest.approx(12, abs=0.3)
