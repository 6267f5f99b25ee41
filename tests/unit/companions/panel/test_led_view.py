"""Simulated cameras can look at the LED panel, and their pictures tell the time."""

import numpy as np
import pytest

from benchmarks.simulated import panel_photographs
from capture_app.common.errors import BadInputError
from capture_app.companions.panel import panel_photograph
from capture_app.plugins.cameras.sim.rendering.picture_source import (
    PictureSource,
    open_picture_source,
)
from capture_app.plugins.cameras.sim.sensor import SensorFrame

ROW_NS, EXPOSURE_NS = 10_840, 97_560


def view(scale: float = 1.0) -> PictureSource:
    size = {"width": 1, "height": 1, "row_time_ns": ROW_NS}
    return open_picture_source("led-panel", "", camera="cam00", scale=scale, **size)


def frame(start_ns: int) -> SensorFrame:
    return SensorFrame(0, 0, start_ns, start_ns, start_ns, EXPOSURE_NS, dropped=False)


@pytest.mark.parametrize("start_ns", [5, 3_987_654_321])
def test_a_picture_tells_when_it_was_taken(start_ns: int) -> None:
    picture = view().render(frame(start_ns), seed=1)
    assert picture.shape == (480, 640, 3)
    read_ns = panel_photographs.read_time(picture, exposure_ns=EXPOSURE_NS, row_time_ns=ROW_NS)
    assert abs(panel_photographs.difference_ns(read_ns, start_ns % panel_photograph.CYCLE_NS)) < 5_000


def test_pictures_are_a_function_of_frame_and_seed() -> None:
    assert np.array_equal(view().render(frame(5), seed=1), view().render(frame(5), seed=1))
    assert not np.array_equal(view().render(frame(5), seed=1), view().render(frame(5), seed=2))


def test_the_panel_has_one_size_and_one_view() -> None:
    assert view().calibration is None
    assert not view().ground_truth(frame(5))[2].any()
    with pytest.raises(BadInputError, match="size"):
        view(scale=0.5)
    with pytest.raises(BadInputError, match="no view"):
        open_picture_source("led-panel", "cam09", camera="x", width=1, height=1, row_time_ns=ROW_NS)
