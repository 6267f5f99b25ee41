"""A newcomer's path: print the board, show it to the rig, take sessions, compare by the kept calibration."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.samples.recipe import CameraRecipe, Recipe
from benchmarks.samples.render import render
from capture_app.session.reading.reader import Session
from reconstruction import cli
from reconstruction.common.geometry import View, angle_deg, other_from_reference
from tests.unit.reconstruction.found import study

CAMERAS = ("cam00", "cam01", "cam04", "cam05")


def take(folder: Path, name: str, scene: str, *, frames: int, spacing: int, at_s: float) -> Path:
    """A session of the simulated rig, without the calibration that only a simulator knows."""
    recipe = Recipe(
        name=name,
        scene=scene,
        cameras=tuple(CameraRecipe(name=camera) for camera in CAMERAS),
        created="2026-11-20T12:00:00Z",
        at_s=at_s,
        frames=frames,
        spacing=spacing,
        depth=False,
    )
    session = render(recipe, folder)[0]
    (session.folder / "calibration.json").rename(folder / f"{name}-true.json")
    return session.folder


def test_from_the_printed_board_to_a_comparison(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))

    def reconstruct(*arguments: object) -> tuple[dict[str, object], str]:
        code = cli.run([*map(str, arguments), "--json"])
        printed = capsys.readouterr()
        assert code == 0, printed.err
        return json.loads(printed.out), printed.err

    page, _ = reconstruct("board", tmp_path / "board.pdf")
    assert page["options"] == []

    board = take(tmp_path, "board", "board", frames=32, spacing=37, at_s=10.0)
    coverage, _ = reconstruct("calibrate", board, "--coverage")
    assert coverage["missing"] == []
    found, _ = reconstruct("calibrate", board, "--from", "charuco")
    assert found["stored"]
    assert found["kept"]
    ours = Session.open(board).calibration()
    shutil.copy(tmp_path / "board-true.json", board / "calibration.json")
    true = Session.open(board).calibration()
    assert ours is not None
    assert true is not None
    for name in CAMERAS[1:]:
        (turn, move), (true_turn, true_move) = (
            other_from_reference(*(View.from_calibration(c.cameras[n], 640, 480) for n in (CAMERAS[0], name)))
            for c in (ours, true)
        )
        assert np.degrees(np.linalg.norm(cv2.Rodrigues(turn @ true_turn.T)[0])) < 0.3
        assert np.linalg.norm(move) == pytest.approx(np.linalg.norm(true_move), rel=0.02)
        assert angle_deg(move, true_move) < 1.5
        assert ours.cameras[name].fx == pytest.approx(520, rel=0.01)

    sessions = [
        take(tmp_path, f"jump-{k}", "studio", frames=4, spacing=2, at_s=12.0 + 3 * k) for k in range(3)
    ]
    options = "--max-multiview-instants", 0, "--max-instants", 2, "--out", tmp_path / "out"
    compared, said = reconstruct("compare", sessions[-1], *options)
    assert "kept from board of 2026-11-20" in str(compared["calibration"])
    assert "no camera has moved" in said
    assert not study(compared, "stereo")["skipped"]
    assert not (sessions[-1] / "calibration.json").exists()
