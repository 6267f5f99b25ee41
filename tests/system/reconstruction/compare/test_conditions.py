"""Conditions as data: lists of offsets, drawn ones, another session, each beside the synchronized one."""

from pathlib import Path

import pytest

from capture_app.session.reading.reader import Session
from tests.unit.reconstruction.conftest import VIEWS, Reconstruct, Scene, write_session
from tests.unit.reconstruction.found import changes, study, values


def test_compare_judges_further_conditions_beside_the_synchronized_one(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    out = tmp_path / "out"
    pairs = ("--stereo-pair", "left,right", "--panorama-pair", "left,aside", "--max-multiview-instants", 0)
    listed = ("--condition", "left=33,right=0", "--condition", "left=33,right=33")
    more = (*listed, "--against", boards.folder, "--out", out, "--json")
    result = reconstruct("compare", boards.folder, *pairs, *more).result
    early, same, itself = result["conditions"]
    stereo, panorama = study(early, "stereo"), study(early, "panorama")
    assert stereo["offsets_ms"]["right"] == pytest.approx(-33.3, abs=0.1)
    assert values(stereo)["mover_within_2pct"] > 0.9
    assert values(stereo, "offset")["mover_within_2pct"] < 0.05
    change = changes(stereo)["mover_within_2pct"]
    assert change["low"] <= change["value"] <= change["high"] < -0.8
    assert abs(changes(stereo)["static_coverage"]["value"]) < 0.02
    assert values(panorama, "offset")["mover_misfit_px"] > values(panorama)["mover_misfit_px"]
    assert "equally late" in study(same, "stereo")["skipped"]
    assert itself["session"] == str(boards.folder)
    assert values(study(itself, "stereo"), "offset")["mover_within_2pct"] > 0.9
    assert len(result["tolerance"]["points"]) == 5
    assert len(study(result, "burst")["facts"]["thumbnails"]) == 3
    page = (out / "report.html").read_text("utf-8")
    for words in ("All conditions", "The burst", "Delay that this motion tolerates", "Every instant"):
        assert words in page


def test_a_session_of_other_cameras_is_skipped_with_its_reasons(
    boards: Session, scene: Scene, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    views = {"left": VIEWS["left"], "other": VIEWS["right"]}
    other = write_session(tmp_path / "other", scene, views, instants=2, truth=False)
    few = ("--max-instants", 1, "--max-multiview-instants", 0, "--panorama-pair", "left,aside")
    out = ("--out", tmp_path / "out", "--json")
    done = reconstruct("compare", boards.folder, *few, "--against", other.folder, *out)
    (condition,) = done.result["conditions"]
    assert study(condition, "stereo")["skipped"] == "camera right has no calibration"
    assert study(condition, "triangulation")["skipped"] == "no calibration of right, aside"
    assert "has no images of left and aside of one instant" in study(condition, "panorama")["skipped"]
