"""A rig's calibration is kept, found again, checked against each session, and refused when a camera moved."""

import shutil
from pathlib import Path

import msgspec

from capture_app.session.reading.reader import Session
from reconstruction.scene.calibration.stored import (
    keep_calibration,
)
from reconstruction.scene.dataset import Dataset
from tests.unit.reconstruction.conftest import (
    Reconstruct,
    write_session,
)
from tests.unit.reconstruction.scene.calibration.test_kept_calibration import (
    RIG,
    ROOM,
    bare,  # noqa: F401 - a fixture
    calibration,
    turned,
)


def test_the_rig_s_calibration_is_found_and_said(
    bare: Session, reconstruct: Reconstruct, tmp_path: Path
) -> None:
    keep_calibration(Dataset(bare), calibration(RIG))
    out = tmp_path / "depth"
    done = reconstruct("stereo", bare.folder, "--pair", "b,c", "--out", out, "--json")
    assert done.result["calibration"].startswith("a board, kept from boards of ")
    assert done.result["unit"] == "m"
    assert "calibration kept from boards" in done.err
    assert "no camera has moved (points at rest fit within" in done.err
    assert not (bare.folder / "calibration.json").exists()


def test_a_panorama_takes_its_lenses_from_the_rig_s_calibration(
    bare: Session, reconstruct: Reconstruct, tmp_path: Path
) -> None:
    plain = reconstruct("panorama", bare.folder, "--out", tmp_path / "plain", "--json").result
    assert plain["calibration"] == ""
    keep_calibration(Dataset(bare), calibration(RIG))
    done = reconstruct("panorama", bare.folder, "--out", tmp_path / "known", "--json")
    assert done.result["calibration"].startswith("a board, kept from boards of ")
    assert "no camera has moved" in done.err


def test_a_calibration_is_given_from_one_session_to_another(
    bare: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    giver = write_session(tmp_path / "giver", ROOM, RIG, instants=1, truth=False)
    taker = tmp_path / "taker"
    shutil.copytree(bare.folder, taker)
    done = reconstruct("calibrate", taker, "--from", giver.folder, "--json").result
    assert done["stored"]
    assert not done["kept"]
    assert done["source"] == "boards, given by boards"
    assert done["check"]["moved"] == []
    stored = Session.open(taker).calibration()
    assert stored is not None
    assert stored.cameras == calibration(RIG).cameras

    refused = reconstruct("calibrate", bare.folder, "--from", "kept")
    assert refused.code == 3
    assert "no calibration is kept of these cameras in these modes: a 320x240" in refused.complaint
    nowhere = reconstruct("calibrate", bare.folder, "--from", tmp_path / "nowhere")
    assert nowhere.code == 2
    moved = {**RIG, "d": turned(RIG["d"], pitch_px=12.0)}
    file = tmp_path / "moved.json"
    file.write_bytes(msgspec.json.encode(calibration(moved)))
    refused = reconstruct("calibrate", bare.folder, "--from", file)
    assert refused.code == 3
    assert "this calibration does not hold for these pictures: d moved: 1" in refused.complaint
    assert not (bare.folder / "calibration.json").exists()
