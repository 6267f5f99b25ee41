"""The compiled engine beside the array version, and the GPU's (by a software driver) beside the CPU."""

import numpy as np

from reconstruction.depth.rough_scene import find_rough_scene
from reconstruction.depth.sweep_engine import SweepEngine
from reconstruction.methods.multiview.sweep_matcher import (
    match_all_views,
)
from tests.unit.reconstruction.depth.small_views import PLACES, choose_by_depth, photo_of, view_at
from tests.unit.reconstruction.methods.multiview.test_engines import (
    NUMPY,
    adapters,  # noqa: F401 - a fixture
    engine,  # noqa: F401 - a fixture
    software_gpu,  # noqa: F401 - a fixture
)


def test_the_whole_sweep_finds_the_same_on_either_way(engine: SweepEngine) -> None:
    images = {name: photo_of(view_at(*at), seed=i)[0] for i, (name, at) in enumerate(PLACES.items())}
    sources = choose_by_depth({name: image.view for name, image in images.items()})
    depth_ranges = find_rough_scene(images).depth_ranges
    numpy = match_all_views(images, sources, depth_ranges, engine=NUMPY)
    found = match_all_views(images, sources, depth_ranges, engine=engine)
    for name in images:
        one, other = numpy[name].depth, found[name].depth
        assert np.mean((one > 0) == (other > 0)) > 0.99
        both = (one > 0) & (other > 0)
        assert np.median(np.abs(one - other)[both] / one[both]) < 0.001
        assert np.mean(np.abs(one - other)[both] < 0.01 * one[both]) > 0.98
