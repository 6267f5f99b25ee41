"""A camera that moves while it records is noticed by what should stand still."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from reconstruction.common.geometry import View
from reconstruction.method.timing import measure_pair_timing
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene as OpenScene
from reconstruction.time_offsets.pair_offset import PairOffsets
from tests.unit.reconstruction.conftest import PERIOD_NS, VIEWS, Reconstruct, Scene, write_session

PAIR = {name: VIEWS[name] for name in ("left", "right")}


def on_a_cart(view: View, time: float) -> View:
    """A rig that rolls sideways: 0.03 of the scene's units in a period, about 2.3 px on its wall."""
    return replace(view, translation=view.translation - view.rotation @ np.array([0.03, 0.0, 0.0]) * time)


@pytest.mark.parametrize("command", ["tolerance", "compare"])
def test_a_rig_on_a_moving_cart_is_said(
    scene: Scene, tmp_path: Path, reconstruct: Reconstruct, command: str
) -> None:
    session = write_session(tmp_path / "cart", scene, PAIR, instants=4, truth=False, moved=on_a_cart)
    few = ("--max-instants", "3", "--out", tmp_path / "out", "--json")
    result = reconstruct(command, session.folder, *few).result
    moving = result["timing"]["moving_cameras"]
    assert moving.keys() == {"left", "right"}
    assert all(1 < px < 4 for px in moving.values())
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "The cameras moved while recording" in page
    assert "timing alone makes the difference" not in page


def test_on_a_cart_too_a_late_camera_is_found(scene: Scene, tmp_path: Path) -> None:
    session = write_session(
        tmp_path, scene, PAIR, instants=5, truth=False, moved=on_a_cart, late={"right": 1.0}
    )
    opened = OpenScene(Dataset.open(session.folder))
    timing = measure_pair_timing(PairOffsets(opened), ("left", "right"))
    assert timing.moving_cameras.keys() == {"left", "right"}
    assert timing.offset
    assert timing.late_ms == pytest.approx(PERIOD_NS / 1e6, abs=2)
