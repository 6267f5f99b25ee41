"""What stands still keeps the depth of an earlier instant; what moves, or was uncovered, gets its own."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import CalibratedImage, SourceView
from reconstruction.depth.plane_sweep import Surface
from reconstruction.depth.sweep_kernels import warp
from reconstruction.methods.multiview.still_scene import StillScene, boxes_around
from reconstruction.methods.multiview.sweep_matcher import ViewDepth, match_all_views
from tests.unit.reconstruction.depth.small_views import PAINT, PLACES, choose_by_depth, photo_of, view_at

NEAR_M, HALF_M = 1.4, 0.16
WIDE = np.ones((13, 13), np.uint8)
RANGES = dict.fromkeys(PLACES, (1.1, 4.0))

Pictures = dict[str, CalibratedImage]


def take(across_m: float, seed: int, near_m: float = NEAR_M) -> tuple[Pictures, dict[str, Array]]:
    """A card before the slanted plane: pictures that know where it moves, and true depth."""
    pictures, truth = {}, {}
    for number, (name, place) in enumerate(PLACES.items()):
        photo, behind = photo_of(view_at(*place), seed=10 * seed + number)
        rays = photo.view.rays(photo.view.grid())
        at = photo.view.centre[:2] + near_m * rays[:, :2] - (across_m, 0.0)
        card = (np.abs(at) < HALF_M).all(1).reshape(behind.shape)
        x, y = (np.mod(150 * at[:, i] + 77, 511).astype(np.float32).reshape(behind.shape) for i in (0, 1))
        grey = np.where(card, 255 - cv2.remap(PAINT, x, y, cv2.INTER_LINEAR), photo.grey)
        moving = cv2.dilate(card.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        pictures[name] = replace(photo, grey=np.asarray(grey, np.float32), moving=moving)
        truth[name] = np.where(card, near_m, behind)
    return pictures, truth


def match(pictures: Pictures, still: StillScene | None = None) -> dict[str, ViewDepth]:
    sources = choose_by_depth({name: picture.view for name, picture in pictures.items()})
    if still is not None:
        still.look(pictures)
    return match_all_views(pictures, sources, RANGES, still=still)


def right(found: ViewDepth, truth: Array, where: Array) -> float:
    return float(np.mean(np.abs(found.depth - truth)[where] < 0.02 * truth[where]))


@pytest.fixture
def still() -> StillScene:
    """Of the card on the left."""
    known = StillScene()
    match(take(-0.15, 1)[0], known)
    return known


def test_only_what_moves_and_what_it_uncovered_is_swept_again(still: StillScene) -> None:
    pictures, truth = take(0.15, 2)
    before = {name: still.surface(name, picture) for name, picture in pictures.items()}
    found, whole = match(pictures, still), match(pictures)
    left = take(-0.15, 1)[0]
    for name, picture in pictures.items():
        new = still.new(name, picture)
        assert new[picture.moving].all()
        assert new[left[name].moving].all()
        assert new.mean() < 0.6
        surface = found[name].surface
        assert surface is not None
        assert np.array_equal(surface.inverse_depth[~new], before[name].inverse_depth[~new])
        assert right(found[name], truth[name], new) > right(whole[name], truth[name], new) - 0.03 > 0.75
    middle = found["middle"].depth[left["middle"].moving & ~pictures["middle"].moving]
    assert np.median(middle) > 1.8


def test_what_was_hidden_from_a_source_is_swept_again() -> None:
    pictures, truth = take(-0.15, 1, near_m=0.8)
    known, flat = StillScene(), np.zeros((96, 128), np.float32)
    known.look(pictures)
    found = {name: Surface((1 / depth).astype(np.float32), flat, flat, flat) for name, depth in truth.items()}
    known.keep(pictures, choose_by_depth({name: one.view for name, one in pictures.items()}), found)
    known.look({name: replace(one, moving=np.zeros_like(flat, bool)) for name, one in pictures.items()})
    for name, other in (("middle", "left"), ("middle", "right"), ("right", "middle")):
        moving, card = (np.asarray(pictures[one].moving, np.float32) for one in (name, other))
        to_other = SourceView(pictures[name], replace(pictures[other], grey=card))
        hidden = (warp(to_other, found[name].inverse_depth) > 0.5) & (cv2.dilate(moving, WIDE) == 0)
        assert hidden.mean() > 0.005
        assert known.new(name, pictures[name])[hidden].all()
        assert known.new(name, pictures[name]).mean() < 0.6


@pytest.mark.parametrize("change", ["light", "nudge", "camera"])
def test_all_is_swept_again_where_more_has_changed_than_what_moves(change: str, still: StillScene) -> None:
    pictures, _ = take(-0.15, 2)
    if change == "light":
        pictures = {name: replace(one, grey=1.3 * one.grey) for name, one in pictures.items()}
    elif change == "nudge":
        pictures = {name: replace(one, grey=np.roll(one.grey, 4, axis=1)) for name, one in pictures.items()}
    else:
        del pictures["left"]
    still.look(pictures)
    assert all(still.new(name, picture).all() for name, picture in pictures.items())


def test_boxes_hold_a_mask_once_with_room_around() -> None:
    new = np.zeros((400, 300), bool)
    new[100:220, 40:90] = new[150:170, 200:290] = True
    boxes = boxes_around(new)
    assert np.array_equal(np.sum([mine for _, mine in boxes], axis=0), new)
    for box, mine in boxes:
        inside = np.zeros_like(new)
        inside[box] = True
        assert inside[cv2.dilate(mine.astype(np.uint8), np.ones((15, 15))) > 0].all()
    assert sum(new[box].size for box, _ in boxes) < 0.4 * new.size
