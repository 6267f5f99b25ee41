"""A lamp that blinks before rolling shutters tells how late each is, and how long its rows take."""

from pathlib import Path

import numpy as np
import pytest

from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import Array
from reconstruction.scene.dataset import Dataset
from reconstruction.time_offsets.camera_time import CameraTime
from reconstruction.time_offsets.lamp import measure_light_offsets
from tests.reconstruction.conftest import Reconstruct, texture
from tests.reconstruction.time_offsets.blinking import BlinkCamera, Lamp, blink_times, write_blinks

ROWS, COLUMNS = 240, 80
SLOW_ROWS_NS, FAST_ROWS_NS = 115_000, 70_000


def light(seed: int) -> list[Array]:
    """A textured wall before which something bright moves."""
    wall = (texture(seed)[:ROWS, :COLUMNS] / 255.0) ** 2.2
    images = []
    for k in range(20):
        image = wall.copy()
        image[80:200, 2 * k : 2 * k + 14] = 0.6
        images.append(image)
    return images


LATE_NS = 9_300_000
FIRST = BlinkCamera(light(1), SLOW_ROWS_NS, 3_000_000)
SECOND = BlinkCamera(
    light(2), FAST_ROWS_NS, 8_000_000, LATE_NS, period_share=0.3, gamma=1 / 1.9, s_curve=-0.1, quality=80
)


def blinks(root: Path, lamp: Lamp | None = None, **cameras: BlinkCamera) -> Session:
    lamp = lamp or Lamp(blink_times(np.random.default_rng(3), 6))
    return write_blinks(root, "lamp", cameras, lamp, seed=5)


def offsets(session: Session) -> dict[str, CameraTime]:
    return measure_light_offsets(Dataset.open(session.folder), "a")


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


@pytest.mark.slow
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


def test_without_a_lamp_nothing_is_told(tmp_path: Path) -> None:
    dark = Lamp(blink_times(np.random.default_rng(3), 3), strength=0.0)
    found = offsets(blinks(tmp_path, dark, a=FIRST, b=SECOND))
    assert {one.offset_ms for one in found.values()} == {None}
    assert found["b"].reason == "it sees no blinking lamp"
