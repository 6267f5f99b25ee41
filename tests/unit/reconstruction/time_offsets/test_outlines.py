"""Centres of small moving objects, whole and partly as bright as what is behind them."""

import cv2
import numpy as np
import pytest

from reconstruction.time_offsets.outlines import Outlines, find_outlines, moves_evenly, similar_objects


def test_an_object_that_is_partly_as_bright_as_the_background_has_an_uncertain_centre() -> None:
    ys, xs = np.mgrid[:160, :160]
    ball = np.hypot(xs - 40.3, ys - 39.6) < 9
    dark = np.full((160, 160), 40.0)
    door = np.where((xs > 42) & (ys < 38), 170.0, 40.0)
    errors = []
    for background in (dark, door):
        image = np.where(ball, 170, background).astype(np.uint8)
        found = find_outlines(image, background.astype(np.float32), np.ones((160, 160), bool))
        assert len(found.at) == 1
        errors.append(float(found.errors_px[0]))
        assert np.abs(found.at[0] - (40.3, 39.6)).max() < max(0.3, 3 * errors[-1])
    assert errors[0] < 0.15
    assert errors[1] > 0.4


@pytest.mark.parametrize(
    ("at", "even"),
    [
        (((0, 0), (9, 4), (18, 9)), True),
        # It falls, and turns.
        (((0, 0), (9, 4), (18, 12)), True),
        (((0, 0), (1, 1), (0, 2)), True),
        (((0, 0), (1, 1), (np.nan, np.nan)), True),
        # A part that vanishes was taken for another one, to either side or to both.
        (((0, 0), (1, 1), (41, 45)), False),
        (((40, 48), (0, 0), (40, 46)), False),
        # Late by a frame, or a bounce: its own path tells no time, its place does.
        (((0, 0), (20, 0), (20, 0)), False),
    ],
)
def test_an_object_that_jumps_is_not_followed(at: tuple[tuple[float, float], ...], even: bool) -> None:
    path = np.array(at, float)[:, None]
    assert [*moves_evenly(path, np.array([[0.0], [33.0], [66.0]]))] == [even]
    assert [*moves_evenly(path[::-1], np.array([[66.0], [33.0], [0.0]]))] == [even]
    # After a gap of a frame it is as fast.
    longer = np.concatenate([path[:2], path[1:2] + 2 * (path[2:] - path[1:2])])
    assert [*moves_evenly(longer, np.array([[0.0], [33.0], [99.0]]))] == [even]


def bodies(*drawn: tuple[int, int, int, int], shape: tuple[int, int] = (200, 200)) -> Outlines:
    """The outlines found of bright ellipses, each by its centre and radii, all of which move."""
    background = np.full(shape, 40, np.uint8)
    image = background.copy()
    for x, y, wide, high in drawn:
        cv2.ellipse(image, (x, y), (wide, high), 0, 0, 360, 170, -1)
    return find_outlines(image, background.astype(np.float32), np.ones(shape, bool))


def test_small_compact_objects_within_the_image_are_found_largest_first() -> None:
    found = bodies((40, 50, 5, 5), (120, 60, 8, 8), (60, 150, 6, 7))
    assert found.at == pytest.approx(np.array([(120, 60), (60, 150), (40, 50)]), abs=0.3)
    assert found.area == pytest.approx([200, 150, 95], rel=0.2)
    # Too small, too large, too long, or not all of it in the image.
    for other in ((100, 100, 1, 1), (100, 100, 18, 18), (100, 100, 4, 12), (4, 100, 5, 5), (100, 194, 5, 5)):
        assert bodies(other).at.shape == (0, 2), other
    assert len(bodies((100, 100, 14, 14)).at) == 1
    assert len(bodies((7, 100, 4, 4)).at) == 1
    # What is too large does not hide the others, and four are enough.
    assert len(bodies((100, 100, 25, 25), (30, 30, 5, 5)).at) == 1
    six = bodies(*((30 * k + 20, 100, 4 + k % 2, 5) for k in range(6)))
    assert len(six.at) == 4


def test_what_does_not_move_or_is_bent_is_no_object() -> None:
    background = np.full((200, 200), 40, np.uint8)
    image = background.copy()
    cv2.circle(image, (60, 60), 6, 170, -1)
    cv2.circle(image, (140, 60), 6, 170, -1)
    moving = np.zeros((200, 200), bool)
    moving[55:65, 130:150] = True
    assert find_outlines(image, background.astype(np.float32), moving).at == pytest.approx(
        np.array([[140, 60]]), abs=0.2
    )
    ring = background.copy()
    cv2.ellipse(ring, (100, 100), (12, 12), 0, 0, 270, 170, 3)
    assert len(find_outlines(ring, background.astype(np.float32), np.ones((200, 200), bool)).at) == 0
    # Another brightness of the whole image is no object, nor is noise one.
    noise = np.random.default_rng(3).normal(60, 4, (200, 200)).astype(np.uint8)
    assert len(find_outlines(noise, background.astype(np.float32), np.ones((200, 200), bool)).at) == 0
    assert len(find_outlines(image + 30, background.astype(np.float32), np.ones((200, 200), bool)).at) == 2


def outlines(*objects: tuple[float, float, float]) -> Outlines:
    x, y, area = np.array(objects, float).reshape(-1, 3).T
    return Outlines(np.column_stack([x, y]), area, np.zeros(len(area)))


def test_an_object_is_followed_to_the_only_one_of_its_size_nearby() -> None:
    here = outlines((50, 50, 100), (150, 50, 100))
    assert here.nearest(outlines((100, 70, 140), (140, 90, 149))).tolist()[0] == [100, 70]
    assert np.isnan(here.nearest(outlines((50, 111, 100)))[0]).all()
    assert np.isnan(here.nearest(outlines((50, 60, 151)))[0]).all()
    assert np.isnan(here.nearest(outlines((50, 60, 66)))[0]).all()
    assert here.nearest(outlines((50, 109, 67))).tolist()[0] == [50, 109]
    # Two of its size are nearby.
    assert np.isnan(here.nearest(outlines((50, 60, 100), (60, 50, 100)))[0]).all()
    assert np.isnan(here.nearest(None)).all()
    assert np.isnan(here.nearest(outlines())).all()


def test_objects_of_two_cameras_may_be_the_same_if_their_areas_are_within_2_25() -> None:
    a, b = outlines((0, 0, 100), (0, 0, 50)), outlines((9, 9, 220), (9, 9, 23), (9, 9, 60))
    of_a, of_b = similar_objects(a, b)
    assert [*zip(of_a.tolist(), of_b.tolist(), strict=True)] == [(0, 0), (0, 2), (1, 1), (1, 2)]
