"""The cycle code of a screen's panel: it is read as it was drawn, and a damaged one is not read."""

import numpy as np
import pytest

from benchmarks.simulated.panel_photographs import HandheldPhotograph
from capture_app.companions.panel.cycle_code import (
    Cycle,
)
from capture_app.companions.panel.time_reading import read_panel
from tests.unit.companions.panel.test_cycle_code import SCREEN

ASKEW = ((70.0, 60.0), (560.0, 90.0), (540.0, 420.0), (90.0, 400.0))


@pytest.mark.parametrize("cycle", [Cycle(0, 0), Cycle(2748, 42), None])
def test_a_photograph_tells_the_turn(cycle: Cycle | None) -> None:
    photograph = HandheldPhotograph(
        SCREEN, 640, 480, ASKEW, 8e6, 20e3, defocus=0.9, motion=(2, 1), lamp_light=0.6, cycle=cycle
    )
    read = read_panel(photograph.take(7e9, np.random.default_rng(3)), exposure_ns=8e6, row_time_ns=20e3)
    assert read.cycle == cycle
