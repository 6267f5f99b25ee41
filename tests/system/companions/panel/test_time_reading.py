"""The time is read off photographs of panels that nobody described, or they are refused."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.panel.photographs import draw_case
from benchmarks.panel.read_photographs import judge
from capture_app.companions.panel.finder import PanelNotFoundError
from capture_app.companions.panel.time_reading import read_panel
from tests.unit.companions.panel.test_time_reading import ASKEW, LEDS, take


@pytest.mark.parametrize(("seed", "screen"), [(1, False), (2, False), (3, True)], ids=str)
def test_photographs_tell_their_time_within_their_error_bar(seed: int, screen: bool) -> None:
    outcome = judge(draw_case(seed, screen=screen))
    assert not outcome.refusal
    assert abs(outcome.error_ns) < outcome.limit_ns
    assert abs(outcome.error_ns) < 1.5 * outcome.uncertainty_ns


def test_one_covered_marker_does_no_harm_and_two_are_said() -> None:
    read = read_panel(take(replace(LEDS, hidden=(2,)), 4e8), exposure_ns=1e6, row_time_ns=12e3)
    assert read.markers == 3
    assert read.panel.name == "led-pair"
    middle_ns, _ = read.at_row(0)
    assert abs(middle_ns - (4e8 + 0.5e6)) < 50_000
    with pytest.raises(PanelNotFoundError, match="2 markers"):
        read_panel(take(replace(LEDS, hidden=(0, 2)), 4e8))


def test_an_unknown_shutter_is_found_with_the_time() -> None:
    read = read_panel(take(LEDS, 7.7e8))
    assert read.shutter.exposure_ns == pytest.approx(1e6, rel=0.1)
    assert abs(read.shutter.row_time_ns - 12e3) < read.row_time_error_ns + 200
    middle_ns, error_ns = read.at_row(0)
    assert abs(middle_ns - (7.7e8 + 0.5e6)) < 2 * error_ns < 500_000


def test_what_tells_no_time_is_refused() -> None:
    grain = np.random.default_rng(1).integers(0, 255, (300, 400, 3)).astype(np.uint8)
    with pytest.raises(PanelNotFoundError, match="no marker"):
        read_panel(grain)
    with pytest.raises(PanelNotFoundError, match="stand out"):
        read_panel(take(replace(LEDS, lamp_light=0.0), 0), exposure_ns=1e6, row_time_ns=12e3)
    small = tuple((x / 8 + 300, y / 8 + 300) for x, y in ASKEW)
    with pytest.raises(PanelNotFoundError):
        read_panel(take(replace(LEDS, corners=small, defocus=0.0), 0), exposure_ns=1e6, row_time_ns=12e3)
