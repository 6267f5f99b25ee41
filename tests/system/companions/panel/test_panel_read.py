"""`capture-app panel read` on the bundled session and on an import that says nothing of its cameras."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.companions.panel import panel_photograph
from tests.unit.companions.panel.test_panel_read import (
    BUNDLED,
    _each_session_is_read_once,  # noqa: F401
)


def test_the_bundled_session_gives_its_truth_back(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["panel", "read", str(BUNDLED), "--json"]) == ExitCode.OK
    told = json.loads(capsys.readouterr().out)
    assert told["panel"] == "led-pair"
    assert len(told["pictures"]) == 10
    assert told["refusals"] == []
    errors = told["errors"]
    assert errors["totals_near_truth"] == {"held": 5, "count": 5}
    assert errors["largest_reading_error_ns"] < 10_000
    assert errors["within_bound"] == {"held": 5, "count": 5}
    for error in errors["errors"]:
        assert error["total_ns"] == pytest.approx(error["true_total_ns"], abs=10_000)
        assert error["total_ns"] == pytest.approx(error["phase_ns"] + error["clock_ns"])
    assert abs(errors["rate_error_ppm"]) < errors["rate_uncertainty_ppm"]
    all_pairs = errors["all"]
    words = told["words"]
    bars = "the panel resolves ±20 µs; clocks inside their error bars: 5 of 5"
    assert words["verdict"] == f"30 µs apart on average, 31 µs at most; {bars}"
    assert [row[0] for row in words["tables"][1]["rows"]] == ["cam00", "cam01"]
    assert words["tables"][0]["rows"][0][:3] == ["cam00 - cam01", "total", "30 µs"]
    assert any("inside the session's own error bars: 5 of 5 pairs" in line for line in words["remarks"])
    assert all_pairs["total"]["max_ns"] >= all_pairs["total"]["mean_abs_ns"] > all_pairs["total"]["std_ns"]


def test_an_import_is_read_without_a_word_about_its_cameras(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    late_ns = 3_300_000
    for camera, starts in (("a", (2e8, 2.5e8)), ("b", (2e8 + late_ns, 2.5e8 + late_ns))):
        (tmp_path / "rec" / camera).mkdir(parents=True)
        for number, start_ns in enumerate(starts):
            rng = np.random.default_rng([number, len(camera)])
            picture = panel_photograph.render(int(start_ns), exposure_ns=500_000, row_time_ns=9_000, rng=rng)
            assert cv2.imwrite(str(tmp_path / "rec" / camera / f"{number:04d}.png"), picture)
    arguments = ["--fps", "20", "--out", str(tmp_path), "--name", "s", "--json"]
    assert run(["sessions", "import", str(tmp_path / "rec"), *arguments]) == ExitCode.OK
    capsys.readouterr()
    assert run(["panel", "read", str(tmp_path / "s"), "--json"]) == ExitCode.OK
    told = json.loads(capsys.readouterr().out)
    assert not told["exposures_known"]
    assert [error["total_ns"] for error in told["errors"]["errors"]] == [pytest.approx(late_ns, abs=1e5)] * 2
    assert told["errors"]["within_uncertainty"] is None


def test_a_session_without_a_panel_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["panel", "read", str(BUNDLED.parent / "pinwheel")]) == ExitCode.BAD_INPUT
    assert "no marker of a panel" in capsys.readouterr().err
