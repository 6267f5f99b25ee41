"""`reconstruct movers`: masks of what moves, for other programs."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.common.errors import ExitCode
from reconstruction.cli import run
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.moving_pixels import dilate
from tests.project import JUMPER


def test_masks_of_a_bundled_session(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "masks"
    assert run(["movers", str(JUMPER), "--out", str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    dataset = Dataset.open(JUMPER)
    assert report["masks"] == 25
    assert set(report["moving"]) == set(dataset.cameras)
    for camera in dataset.cameras:
        for instant in (0, 2):
            mask = cv2.imread(str(out / camera / f"{instant:06d}.png"), cv2.IMREAD_GRAYSCALE)
            assert mask is not None
            assert set(np.unique(mask)) == {0, 255}
            truth = dataset.ground_truth(camera, instant)
            assert truth is not None
            moving = truth[1]
            assert (mask[moving] > 0).mean() > 0.75
            assert (mask[~dilate(moving, 20)] > 0).mean() < 0.05
    assert run(["movers", str(JUMPER), "--out", str(out)]) == ExitCode.BAD_INPUT
    assert "has something in it" in capsys.readouterr().err
