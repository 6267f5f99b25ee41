"""Pairs of pictures of a scene."""

from reconstruction.common.geometry import Array, View
from reconstruction.methods.stereo.stereo_pair import StereoPair, find_disparity_range
from tests.unit.reconstruction.conftest import Scene


def synchronized_pair(scene: Scene, reference: View, other: View) -> tuple[StereoPair, Array, Array, Array]:
    """The pair at one time: its matcher, both pictures and the reference's true depth."""
    image, truth, movers = scene.look(reference, 2)
    same = scene.look(other, 2)[0]
    disparities = find_disparity_range((reference, other), [(image, same, movers)])
    return StereoPair(reference, other, disparities), image, same, truth
