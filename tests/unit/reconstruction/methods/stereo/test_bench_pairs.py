"""`make bench NAME=pairs` on a folder laid out as Middlebury's: JSON at the end, or one plain sentence."""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.reconstruction.rectified_pairs import read_pair
from benchmarks.reconstruction.stereo_pairs import main
from capture_app.common.errors import BadInputError, ExitCode
from reconstruction.common.geometry import Array

SHIFT = 9.0


def middlebury_folder(folder: Path) -> Array:
    """A pair from 2014's layout, everything 9 px apart; returns the true disparity, infinite = unknown."""
    rng = np.random.default_rng(4)
    wide = cv2.GaussianBlur(rng.integers(0, 255, (80, 200, 3)).astype(np.uint8), (0, 0), 1.0)
    cv2.imwrite(str(folder / "im0.png"), wide[:, : 200 - int(SHIFT)])
    cv2.imwrite(str(folder / "im1.png"), wide[:, int(SHIFT) :])
    truth = np.full((80, 191), SHIFT, "<f4")
    truth[:7] = np.inf
    # Middlebury's own header: the number is no scale of the values.
    (folder / "disp0.pfm").write_bytes(b"Pf\n191 80\n-0.003922\n" + truth[::-1].tobytes())
    (folder / "calib.txt").write_text("width=191\nheight=80\nndisp=30\n")
    return truth


def test_a_folder_is_read_with_its_truth_and_range(tmp_path: Path) -> None:
    truth = middlebury_folder(tmp_path)
    pair = read_pair(tmp_path)
    assert (pair.truth == np.where(np.isfinite(truth), truth, 0)).all()
    assert pair.count == 32
    assert pair.left.shape == (80, 191, 3)


def test_it_ends_with_a_line_of_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    middlebury_folder(tmp_path)
    monkeypatch.setattr(sys, "argv", ["stereo_pairs", str(tmp_path), "--real-only"])
    assert main() == ExitCode.OK
    (pair,) = json.loads(capsys.readouterr().out.splitlines()[-1])["pairs"].values()
    assert pair["ours"] < 1
    assert pair["sgbm_padded"] < 20
    assert pair["hh_padded"] < 20
    assert pair["cpu_ratio"] > 0


def test_a_street_of_kitti_is_read_by_its_own_steps(tmp_path: Path) -> None:
    truth = middlebury_folder(tmp_path)
    (tmp_path / "disp0.pfm").unlink()
    known = np.isfinite(truth)
    cv2.imwrite(str(tmp_path / "disp0.png"), (np.where(known, truth, 0) * 256).astype(np.uint16))
    assert (read_pair(tmp_path).truth == np.where(known, SHIFT, 0)).all()


@pytest.mark.parametrize("broken", [b"", b"Pf\n9 9\n-1\n", b"Pf\nno size\n-1\n\0\0\0\0"])
def test_a_folder_that_cannot_be_read_is_said(tmp_path: Path, broken: bytes) -> None:
    with pytest.raises(BadInputError, match="holds no pair"):
        read_pair(tmp_path)
    middlebury_folder(tmp_path)
    (tmp_path / "disp0.pfm").write_bytes(broken)
    with pytest.raises(BadInputError, match=r"disp0.pfm cannot be read"):
        read_pair(tmp_path)
