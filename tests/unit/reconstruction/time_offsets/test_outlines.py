"""Centres of small moving objects, whole and partly as bright as what is behind them."""

import numpy as np
import pytest

from reconstruction.time_offsets.outlines import find_outlines, moves_evenly


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
