"""A lamp that blinks before rolling shutters tells how late each is, and how long its rows take."""

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np

from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import Array
from reconstruction.scene.dataset import Dataset
from reconstruction.time_offsets.camera_time import CameraTime
from reconstruction.time_offsets.lamp import find_blink_edges, measure_light_offsets
from tests.unit.reconstruction.conftest import texture
from tests.unit.reconstruction.time_offsets.blinking import BlinkCamera, Lamp, blink_times, write_blinks

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


def test_without_a_lamp_nothing_is_told(tmp_path: Path) -> None:
    dark = Lamp(blink_times(np.random.default_rng(3), 3), strength=0.0)
    found = offsets(blinks(tmp_path, dark, a=FIRST, b=SECOND))
    assert {one.offset_ms for one in found.values()} == {None}
    assert found["b"].reason == "it sees no blinking lamp"


def test_a_brightness_step_far_smaller_than_the_lamps_is_not_an_edge() -> None:
    brightness = np.full(60, 40)
    brightness[10:20] += 40
    brightness[40:50] += 40
    brightness[30:] += 4
    dataset = SimpleNamespace(
        instants=lambda camera: range(60), grey=lambda camera, k: np.full((4, 16), brightness[k], np.uint8)
    )
    rows_ms = {k: 33.0 * k + np.arange(4) for k in range(60)}
    edges = find_blink_edges(cast(Dataset, dataset), "a", rows_ms)
    assert [edge.rising for edge in edges] == [True, False, True, False]
