"""Every method with depth calibrates a session that has no calibration, once."""

import shutil
from pathlib import Path

import pytest

from capture_app.session.format.calibration import Calibration
from capture_app.session.reading.reader import Session
from reconstruction.scene import scene as module
from tests.unit.reconstruction.conftest import Reconstruct

QUICK = {"view": ("--frames", 2, "--quick"), "splat": ("--iterations", 0, "--quick"), "stereo": ()}


@pytest.mark.parametrize("method", QUICK)
def test_it_is_calibrated_by_its_pictures(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    calls, known = list[object](), boards.calibration()
    assert known is not None

    def guess(motion: object) -> Calibration:
        calls.append(motion)
        return known

    monkeypatch.setattr(module, "guess_calibration", guess)
    bare = tmp_path / "bare"
    shutil.copytree(boards.folder, bare)
    (bare / "calibration.json").unlink()
    done = reconstruct(method, bare, *QUICK[method], "--out", tmp_path / "out")
    assert done.code == 0, done.err
    assert len(calls) == 1
