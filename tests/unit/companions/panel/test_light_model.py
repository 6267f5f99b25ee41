"""A panel's light at a time, by its exact model and by the quicker one for times in equal steps."""

import cv2
import numpy as np
import pytest

from benchmarks.simulated.panel_photographs import HandheldPhotograph
from capture_app.companions.panel.finder import find_panel
from capture_app.companions.panel.light_model import LightModel, Shutter
from capture_app.companions.panel.pattern import PANELS

SCREEN = PANELS["screen-60hz-down"]
ASKEW = ((62.0, 90.0), (570.0, 140.0), (550.0, 390.0), (80.0, 345.0))


@pytest.mark.parametrize("response_ns", [0.3e6, 4.5e6])
def test_light_in_equal_steps_is_that_of_each_time(response_ns: float) -> None:
    taken = HandheldPhotograph(SCREEN, 640, 480, ASKEW, 4e6, 20e3).take(3e8, np.random.default_rng(1))
    grey = np.asarray(cv2.cvtColor(taken, cv2.COLOR_BGR2GRAY), np.uint8)
    model, shutter = LightModel(find_panel(grey), taken), Shutter(4e6, 20e3)
    times_ns = 3e8 + np.arange(-96, 97) * SCREEN.tick_ns / 64
    exact = model.shares(times_ns, shutter, response_ns=response_ns)
    assert exact.max() > 0.9
    assert np.abs(model.shares_in_steps(times_ns, shutter, response_ns) - exact).max() < 0.02
