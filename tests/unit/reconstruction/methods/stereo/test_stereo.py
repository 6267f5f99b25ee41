"""Depth of a moving board: right when both views show the same time, gone when they do not."""

import numpy as np
import pytest

from reconstruction.common.geometry import View
from reconstruction.methods.stereo.stereo_pair import StereoPair, find_disparity_range
from tests.unit.reconstruction.conftest import Scene, make_view
from tests.unit.reconstruction.methods.stereo.pairs import synchronized_pair

PAIRS = {
    "side by side": (make_view((0, 0, 0)), make_view((0.2, 0, 0)), 1.0),
    "swapped": (make_view((0.2, 0, 0)), make_view((0, 0, 0)), 1.0),
    "one above the other": (make_view((0, -0.1, 0)), make_view((0, 0.1, 0)), 1.0),
    "converging, distorted, in inches": (
        make_view((-0.1, 0, 0), yaw=3, unit=39.37, distortion=(-0.2, 0.05, 0.001, 0, 0)),
        make_view((0.1, 0.02, 0), yaw=-2, roll=2, unit=39.37, distortion=(-0.15, 0, 0, 0.001, 0)),
        39.37,
    ),
}


@pytest.mark.parametrize(("reference", "other", "unit"), PAIRS.values(), ids=PAIRS.keys())
def test_a_moving_board_has_depth_only_when_synchronized(
    scene: Scene, reference: View, other: View, unit: float
) -> None:
    image, truth, movers = scene.look(reference, 2, unit)
    same, later = scene.look(other, 2, unit)[0], scene.look(other, 4, unit)[0]
    disparities = find_disparity_range((reference, other), [(image, same, movers)])
    pair = StereoPair(reference, other, disparities)

    synced = pair.compute_depth(image, same).depth
    right = np.abs(synced - truth) < 0.02 * truth
    assert right[movers].mean() > 0.93
    assert right[~movers].mean() > 0.75
    believed = synced > 0
    assert right[believed].mean() > 0.95

    offset = pair.compute_depth(image, later).depth
    assert (np.abs(offset - truth) < 0.02 * truth)[movers].mean() < 0.05
    assert (offset > 0)[movers].mean() < 0.25


@pytest.mark.parametrize(("gain", "bias"), [(0.6, 0), (0.8, 40), (1.3, -25)])
def test_a_camera_that_exposes_otherwise_is_matched_as_well(scene: Scene, gain: float, bias: float) -> None:
    pair, image, same, truth = synchronized_pair(scene, *PAIRS["side by side"][:2])
    alike = pair.compute_both(image, same)[1]
    other = pair.compute_both(image, np.clip(gain * same.astype(float) + bias, 0, 255).astype(np.uint8))[1]
    for depth, before in ((other.depth, alike.depth), (other.filled, alike.filled)):
        share, wanted = ((np.abs(found - truth) < 0.02 * truth).mean() for found in (depth, before))
        assert share > wanted - 0.03


def test_views_of_different_things_are_refused(scene: Scene) -> None:
    rng = np.random.default_rng(3)
    noise = [rng.integers(0, 255, (240, 320)).astype(np.uint8) for _ in range(2)]
    pair = make_view((0, 0, 0)), make_view((0.2, 0, 0))
    with pytest.raises(ValueError, match="too little in common"):
        find_disparity_range(pair, [(noise[0], noise[1], np.zeros((240, 320), bool))])
