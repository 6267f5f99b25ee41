"""The time is read off photographs of panels that nobody described, or they are refused."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.simulated.panel_photographs import HandheldPhotograph
from capture_app.companions.panel.finder import PanelNotFoundError
from capture_app.companions.panel.pattern import PANELS
from capture_app.companions.panel.time_reading import read_panel

PAIR = PANELS["led-pair"]
ASKEW = ((62.0, 90.0), (570.0, 140.0), (550.0, 390.0), (80.0, 345.0))
LEDS = HandheldPhotograph(PAIR, 640, 480, ASKEW, 1e6, 12e3, defocus=0.8, motion=(2, 1), uneven=0.05)


def take(
    photograph: HandheldPhotograph, start_ns: float
) -> "np.ndarray[tuple[int, ...], np.dtype[np.uint8]]":
    return photograph.take(start_ns, np.random.default_rng(5))


def test_a_whole_cycle_of_exposure_tells_no_time() -> None:
    single = replace(LEDS, panel=PANELS["led-200us"], exposure_ns=20e6)
    with pytest.raises(PanelNotFoundError):
        read_panel(take(single, 3e6), exposure_ns=20e6, row_time_ns=12e3)


def test_lamps_that_follow_no_clock_are_refused() -> None:
    wrong = replace(LEDS.panel, ticks=(1, 7), tick_ns=330_000.0)
    with pytest.raises(PanelNotFoundError, match="led-pair"):
        read_panel(take(replace(LEDS, panel=wrong), 3e8), exposure_ns=1e6, row_time_ns=12e3)
