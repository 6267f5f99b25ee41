"""A lamp that blinks before rolling shutters tells how late each is, and how long its rows take."""

from pathlib import Path

import numpy as np

from tests.unit.reconstruction.conftest import Reconstruct
from tests.unit.reconstruction.time_offsets.blinking import BlinkCamera, Lamp, blink_times
from tests.unit.reconstruction.time_offsets.test_light_offsets import (
    FAST_ROWS_NS,
    FIRST,
    LATE_NS,
    ROWS,
    SECOND,
    blinks,
    light,
    offsets,
)


def test_a_lamp_tells_how_late_a_camera_is(tmp_path: Path, reconstruct: Reconstruct) -> None:
    session = blinks(tmp_path, a=FIRST, b=SECOND)
    result = reconstruct("time", session.folder, "--json").result
    assert result["reference"] == "a"
    found = result["cameras"]["b"]
    assert abs(found["offset_ms"] - LATE_NS / 1e6) < 0.15
    assert abs(found["offset_ms"] - LATE_NS / 1e6) < 2.5 * found["sd_ms"]
    assert found["sd_ms"] < 0.45
    assert found["source"] == "light"
    assert found["edges"] >= 8
    assert result["calibration"] == "", "light takes no geometry"


def test_row_times_that_nobody_told_are_learnt(tmp_path: Path) -> None:
    untold = BlinkCamera(light(2), FAST_ROWS_NS, 4_000_000, LATE_NS, period_share=0.55, rows_untold=True)
    found = offsets(blinks(tmp_path, a=FIRST, b=untold))["b"]
    assert found.row_time_ns is not None
    assert found.row_time_sd_ns is not None
    assert found.row_time_sd_ns < 0.1 * FAST_ROWS_NS
    assert abs(found.row_time_ns - FAST_ROWS_NS) < 3 * found.row_time_sd_ns
    # Its one time is taken for that of its middle row.
    assert found.offset_ms is not None
    assert abs(found.offset_ms - (LATE_NS + FAST_ROWS_NS * ROWS / 2 + 2_000_000) / 1e6) < 1.0


def test_a_lamp_without_an_edge_is_told(tmp_path: Path) -> None:
    bulb = Lamp(blink_times(np.random.default_rng(3), 5), lasts_ms=260, rise_ms=60)
    found = offsets(blinks(tmp_path, bulb, a=FIRST, b=SECOND))
    assert found["b"].offset_ms is None
    assert "it has no edge" in found["b"].reason
