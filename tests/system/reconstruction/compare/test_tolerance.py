"""The tolerance curve: it falls on what moves, not on what stands still, and its words and drawing say so."""

import json
from pathlib import Path

import pytest

from capture_app.session.reading.reader import Session
from tests.unit.reconstruction.conftest import PERIOD_NS, VIEWS, Reconstruct, Scene, write_session
from tests.unit.reconstruction.found import values


def test_it_falls_on_what_moves_and_not_on_what_stands_still(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    out = tmp_path / "out"
    result = reconstruct("tolerance", boards.folder, "--pair", "left,right", "--out", out, "--json").result
    assert result == json.loads((out / "metrics.json").read_text())
    assert [point["facts"]["offset_frames"] for point in result["points"]] == [-2, -1, 0, 1, 2]
    moving = [values(point, "offset")["mover_within_2pct"] for point in result["points"]]
    still = [values(point, "offset")["static_coverage"] for point in result["points"]]
    assert moving.pop(2) > 0.9
    assert max(moving) < 0.1
    assert max(still) - min(still) < 0.02
    assert result["decreasing"]
    assert 0 < result["tolerable_offset_ms"] < 33
    page = (out / "report.html").read_text("utf-8")
    assert "This motion tolerates a delay of about" in page
    timing = result["timing"]
    assert timing["synchronized"]
    assert abs(timing["late_ms"]) <= timing["uncertainty_ms"] < 3
    assert len(timing["instants"]) >= 3
    assert result["peak_ms"] == 0
    assert all(one["peak_ms"] in (0, None) for one in result["per_instant"])


@pytest.mark.parametrize("pair", ["right,left", "left,right"])
def test_a_camera_that_is_a_frame_late_is_not_called_synchronized(
    scene: Scene, tmp_path: Path, reconstruct: Reconstruct, pair: str
) -> None:
    pictures = {name: VIEWS[name] for name in ("left", "right")}
    session = write_session(tmp_path / "late", scene, pictures, late={"right": 1.0})
    out = tmp_path / "out"
    result = reconstruct("tolerance", session.folder, "--pair", pair, "--out", out, "--json").result
    timing, sign = result["timing"], 1 if pair.endswith("right") else -1
    assert not timing["synchronized"]
    assert abs(timing["late_ms"] - sign * PERIOD_NS / 1e6) <= 1.5 * timing["uncertainty_ms"]
    assert result["peak_ms"] == pytest.approx(-sign * PERIOD_NS / 1e6, abs=0.1)
    assert result["tolerable_offset_ms"] is None
    page = (out / "report.html").read_text("utf-8")
    assert "These cameras were not synchronized" in page
    assert f"--time-shift-ms {pair.split(',')[1]}={timing['shift_ms']:.4g}" in page
    assert "Synchronized, " not in page
    if pair == "left,right":
        mended = timing["shift_ms"]
        shift = ("--time-shift-ms", f"right={mended}", "--json")
        again = reconstruct("tolerance", session.folder, "--pair", pair, *shift).result["timing"]
        assert again["synchronized"], again
