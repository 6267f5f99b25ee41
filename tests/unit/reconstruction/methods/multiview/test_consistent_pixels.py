"""What stays of a view's depth: what others confirm, or those who can see it."""

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import SourceView
from reconstruction.depth.geometric_consistency import MAX_COST, consistent_and_visible_views
from reconstruction.depth.plane_sweep import Surface
from reconstruction.methods.multiview.consistent_pixels import consistent_pixels
from tests.unit.reconstruction.depth.small_views import HEIGHT, WIDTH, photo_of, view_at


def test_one_vote_is_enough_where_nobody_else_can_see_but_not_against_others() -> None:
    flat = np.zeros((HEIGHT, WIDTH), np.float32)

    def surface(*bands: tuple[int, int, float]) -> Surface:
        level = np.full_like(flat, 0.5)
        for top, bottom, value in bands:
            level[top:bottom] = value
        return Surface(level, flat, flat, flat)

    shots = [photo_of(view_at(x), np.zeros(2))[0] for x in (0.0, -0.1, 0.1, 0.2)]
    source_views = [SourceView(shots[0], other) for other in shots[1:]]
    # To two of three views something near hides the rows 20 to 50; from 50 to 80 they see behind the surface.
    others = [surface(), *(surface((20, 50, 0.8), (50, 80, 0.3)) for _ in range(2))]
    votes = zip(source_views, others, strict=True)
    count, able = consistent_and_visible_views(surface(), votes)
    inner = slice(20, -30)
    assert (count[22:78, inner] == 1).all()
    assert (able[22:48, inner] == 1).all()
    assert (able[52:78, inner] == 3).all()
    kept = consistent_pixels(surface(), count, able, 3, flat > 0)
    assert kept[:18, inner].all()
    assert kept[20:45, inner].all()
    assert not kept[55:75, inner].any()


def test_a_rim_that_one_view_sees_is_kept_beside_a_background_that_none_sees() -> None:
    level, rim = np.full((60, 100), 0.4, np.float32), slice(50, 60)
    level[:, :60] = 0.8
    flat = np.zeros_like(level)
    count, able = (np.zeros(level.shape, np.uint8) for _ in range(2))
    count[:, :50] = able[:] = 2
    count[:, rim] = able[:, rim] = 1
    seen = Surface(level, flat, flat, flat)
    kept = consistent_pixels(seen, count, able, 3, flat > 0)
    assert kept[:, :60].all()
    assert not kept[:, 60:].any()
    # A few pixels whose surface nobody else confirms, as of what moves between the pictures.
    count[:, :56] = 0
    assert not consistent_pixels(seen, count, able, 3, flat > 0).any()


def test_small_islands_stay_only_where_things_are_thin() -> None:
    flat = np.zeros((60, 100), np.float32)
    level = flat + 0.4
    level[20:28, 50:54] = 0.8
    count = np.zeros(level.shape, np.uint8)
    count[20:28, 50:54] = 2
    for has_thin in (False, True):
        kept = consistent_pixels(
            Surface(level, flat, flat, flat), count, np.full_like(count, 3), 3, flat > 0, has_thin=has_thin
        )
        assert kept[20:28, 50:54].all() == has_thin


def test_evidence_comes_in_patches_and_reaches_only_a_little_beyond_them() -> None:
    """A single pixel that matches well is chance: the dark around it stays without depth."""
    flat = np.zeros((60, 100), np.float32)
    count, able = (np.full(flat.shape, 2, np.uint8) for _ in range(2))
    cost = flat + MAX_COST

    def valid(cost: Array) -> Array:
        surface = Surface(flat + 0.4, flat, flat, np.asarray(cost, np.float32))
        return consistent_pixels(surface, count, able, 2, flat == 0, has_thin=True)

    speck, patch = cost.copy(), cost.copy()
    speck[30, 50] = 0
    assert not valid(cost).any()
    assert not valid(speck).any()
    patch[26:35, 46:55] = 0
    kept = valid(patch)
    assert kept[27:34, 47:54].all()
    assert not kept[:, :40].any()
    assert not kept[:, 60:].any()
