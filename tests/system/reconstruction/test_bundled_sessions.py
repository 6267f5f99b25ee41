"""Every command of reconstruct on the bundled sessions, at small settings: what they find is still true."""

import json
from pathlib import Path
from typing import Any

import pytest

from capture_app.session.exporting.point_cloud import read_ply
from reconstruction.cli import run
from reconstruction.common.memory import MEMORY
from tests.project import SAMPLES
from tests.unit.reconstruction.found import study, values


def found(capsys: pytest.CaptureFixture[str], command: str, session: str, *options: object) -> dict[str, Any]:
    """What a command prints as JSON."""
    assert run([command, str(SAMPLES / session), *map(str, options), "--json"]) == 0
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


def test_stereo(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "depth"
    result = found(capsys, "stereo", "jumper", "--out", out)
    assert result["coverage"] > 0.85
    assert result["within_2pct"] > 0.75
    assert (out / result["depth"]).is_file()
    pair = f"{result['reference']},{result['other']}"
    condition = f"{result['other']}=33"
    options = ("--pair", pair, "--instant", 2, "--condition", condition, "--out", tmp_path / "late")
    late = found(capsys, "stereo", "jumper", *options)
    assert (late["instant"], late["other_instant"]) == (2, 3)
    # What stands still is found all the same, what jumps is not.
    assert 0.5 < late["within_2pct"] < result["within_2pct"] - 0.02


def test_multiview(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(MEMORY, "60MB")  # pictures of a third of their size
    out = tmp_path / "depth"
    result = found(capsys, "multiview", "jumper", "--no-mesh", "--out", out)
    assert len(result["views"]) == 5
    assert result["within_2pct"] > 0.7
    assert result["mover_within_2pct"] > 0.8
    # The cloud is what `sessions export --points` takes.
    assert len(read_ply(out / "fused.ply").points) == result["fused_points"] > 5000


def test_panorama(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = found(capsys, "panorama", "crossing", "--out", tmp_path / "panorama")
    assert result["used"] == ["cam00", "cam01", "cam02"]
    assert result["synced"]["misfit"]["median_px"] < 0.6
    assert result["synced"]["mover_misfit"]["median_px"] < 1.5
    assert (tmp_path / "panorama" / result["synced"]["panorama"]).is_file()


def test_tolerance(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    few = ("--max-instants", 2, "--max-offset-ms", 34)
    result = found(capsys, "tolerance", "jumper", *few, "--out", tmp_path / "tolerance")
    share = {
        point["facts"]["offset_frames"]: values(point, "offset")["mover_within_2pct"]
        for point in result["points"]
    }
    assert sorted(share) == [-1, 0, 1]
    assert share[0] > 0.9
    assert max(share[-1], share[1]) < 0.3
    assert (tmp_path / "tolerance" / "report.html").is_file()


def test_compare(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small = ("--max-instants", 1, "--max-multiview-instants", 1, "--multiview-width", 160)
    result = found(capsys, "compare", "crossing", *small, "--out", tmp_path / "compare")
    stereo = study(result, "stereo")
    assert values(stereo)["mover_coverage"] > 0.9
    assert values(stereo, "offset")["mover_coverage"] < 0.2
    assert values(stereo, "offset")["static_coverage"] > 0.9
    assert "the same instant, within what these pictures show" in result["verdict"]
    assert (tmp_path / "compare" / "report.html").is_file()


def test_batch(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("pinwheel", "--instants", 0, "--out", tmp_path / "batch")
    first = found(capsys, "batch", *arguments)
    assert (first["computed"], first["reused"], first["failed"]) == (1, 0, 0)
    again = found(capsys, "batch", *arguments)
    assert (again["computed"], again["reused"], again["failed"]) == (0, 1, 0)
    assert (tmp_path / "batch" / "summary.html").is_file()
