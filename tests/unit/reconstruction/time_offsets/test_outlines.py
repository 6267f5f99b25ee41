"""Centres of small moving objects, whole and partly as bright as what is behind them."""

import numpy as np

from reconstruction.time_offsets.outlines import find_outlines


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
