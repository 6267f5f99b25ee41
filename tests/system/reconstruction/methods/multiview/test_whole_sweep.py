"""The whole sweep by the compiled steps beside the one by arrays."""

import numpy as np
import pytest

from reconstruction.depth.rough_scene import find_rough_scene
from reconstruction.methods.multiview.sweep_matcher import match_all_views
from tests.unit.reconstruction.depth.array_sweep import sweep_by_arrays
from tests.unit.reconstruction.depth.small_views import PLACES, choose_by_depth, photo_of, view_at


def test_the_whole_sweep_finds_the_same_by_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    images = {name: photo_of(view_at(*at), seed=i)[0] for i, (name, at) in enumerate(PLACES.items())}
    sources = choose_by_depth({name: image.view for name, image in images.items()})
    depth_ranges = find_rough_scene(images).depth_ranges
    found = match_all_views(images, sources, depth_ranges)
    sweep_by_arrays(monkeypatch)
    by_arrays = match_all_views(images, sources, depth_ranges)
    for name in images:
        one, other = by_arrays[name].depth, found[name].depth
        assert np.mean((one > 0) == (other > 0)) > 0.99
        both = (one > 0) & (other > 0)
        assert np.median(np.abs(one - other)[both] / one[both]) < 0.001
        assert np.mean(np.abs(one - other)[both] < 0.01 * one[both]) > 0.98
        assert not np.array_equal(one, other)
