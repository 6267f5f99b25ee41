"""Every command holds a session's calibration against its pictures before it makes anything of it."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import View
from reconstruction.scene.calibration.consistency import upside_down
from reconstruction.scene.scene import Scene
from tests.unit.reconstruction.conftest import Reconstruct, write_session
from tests.unit.reconstruction.scene.calibration.test_kept_calibration import RIG, ROOM, calibration, turned

Rig = dict[str, View]


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Rig], Path]:
    """The folder of the rig's session with another calibration."""
    root = tmp_path_factory.mktemp("rigs")
    bare: Session = write_session(root, ROOM, RIG, instants=1, calibrated=False, truth=False)

    def write(views: Rig) -> Path:
        folder = root / str(len(list(root.iterdir())))
        shutil.copytree(bare.folder, folder)
        (folder / "calibration.json").write_bytes(msgspec.json.encode(calibration(views)))
        return folder

    return write


def test_what_is_a_little_off_is_taken(calibrated: Callable[[Rig], Path]) -> None:
    assert Scene.open(calibrated({**RIG, "c": turned(RIG["c"], pitch_px=2.0)})).given


def test_a_fisheye_may_be_upside_down() -> None:
    view = replace(RIG["b"], distortion=np.array([0.02, -0.01, 0.003, 0.001]), is_fisheye=True)
    pixels = np.array([[10.0, 20.0], [150.0, 100.0]])
    turned_pixels = (view.width - 1, view.height - 1) - pixels
    assert upside_down(view).rays(turned_pixels)[:, :2] == pytest.approx(-view.rays(pixels)[:, :2])


def test_of_two_cameras_either_may_be_upside_down(tmp_path: Path, reconstruct: Reconstruct) -> None:
    pair = {name: RIG[name] for name in "bc"}
    session = write_session(tmp_path, ROOM, pair, instants=2, calibrated=False, truth=False)
    views = {**pair, "c": upside_down(pair["c"])}
    (session.folder / "calibration.json").write_bytes(msgspec.json.encode(calibration(views)))
    refused = reconstruct("time", session.folder)
    assert "the pictures of b or c are upside down" in refused.complaint
