"""Edges that windows made too wide are moved back to where pixels match, and true ones stay."""

import cv2
import numpy as np
import pytest

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import CalibratedImage, SourceView
from reconstruction.depth.plane_sweep import Surface
from reconstruction.methods.multiview.edge_sharpening import sharpen_edges
from tests.unit.reconstruction.conftest import Scene, make_view
from tests.unit.reconstruction.depth.array_sweep import sharpen_by_arrays
from tests.unit.reconstruction.depth.small_views import SLOPE, photo_of, view_at

TIME = 2.0


@pytest.fixture(scope="module")
def seen(scene: Scene) -> tuple[list[SourceView], Array]:
    """Two sources on either side of a view of the boards, one of them darker; and its true inverse depth."""
    photos = []
    for x, gain in ((0.0, 1.0), (-0.12, 0.8), (0.12, 1.0)):
        view = make_view((x, 0.0, 0.0))
        grey, depth, _ = scene.look(view, TIME)
        photos.append(CalibratedImage(view, gain * grey.astype(np.float32), 7, 9.0))
        if not x:
            true = 1 / depth
    return [SourceView(photos[0], other) for other in photos[1:]], true


def surface_of(inverse_depth: Array) -> Surface:
    flat = np.zeros_like(inverse_depth)
    return Surface(inverse_depth, flat, flat, flat)


def right(found: Surface, true: Array, where: Array) -> float:
    return float(np.mean((np.abs(found.inverse_depth - true) < 0.01 * true)[where]))


def test_pixels_beside_a_near_surface_get_the_far_depth_again(seen: tuple[list[SourceView], Array]) -> None:
    views, true = seen
    wide = cv2.dilate(true, np.ones((5, 5), np.uint8))
    beside, inner = wide > 1.05 * true, np.s_[8:-8, 40:-40]
    assert beside[inner].sum() > 1000
    found = sharpen_edges(surface_of(wide), views, wide > 0)
    assert right(surface_of(wide), true, beside) == 0
    assert right(found, true, beside) > 0.75
    assert right(found, true, ~beside) > 0.985


def test_true_edges_stay(seen: tuple[list[SourceView], Array]) -> None:
    views, true = seen
    assert right(sharpen_edges(surface_of(true), views, true > 0), true, true > 0) > 0.985


def test_a_slanted_plane_has_no_edges() -> None:
    shots = [photo_of(view_at(x), SLOPE, seed=k) for k, x in enumerate((0.0, -0.1, 0.1))]
    inverse_depth = (1 / shots[0][1]).astype(np.float32)
    slopes = np.gradient(inverse_depth)
    surface = Surface(inverse_depth, slopes[1], slopes[0], np.zeros_like(inverse_depth))
    views = [SourceView(shots[0][0], other) for other, _ in shots[1:]]
    found = sharpen_edges(surface, views, surface.inverse_depth > 0)
    assert np.array_equal(np.stack(found), np.stack(surface))


def test_moved_edges_are_those_of_the_array_version(seen: tuple[list[SourceView], Array]) -> None:
    views, true = seen
    wide = cv2.dilate(true, np.ones((5, 5), np.uint8))
    slopes = 1e-4 * np.random.default_rng(2).standard_normal((2, *true.shape)).astype(np.float32)
    # Pixels without a match stay.
    cost = np.linspace(0, 0.6, wide.size, dtype=np.float32).reshape(wide.shape)
    surface = Surface(wide, slopes[0], slopes[1], cost)
    where = np.ones(wide.shape, bool)
    where[:30] = False
    found, expected = (np.stack(run(surface, views, where)) for run in (sharpen_edges, sharpen_by_arrays))
    moved = expected[0] != wide
    assert 1000 < moved.sum() < 0.2 * moved.size
    assert np.abs(found - expected).max() < 1e-6
