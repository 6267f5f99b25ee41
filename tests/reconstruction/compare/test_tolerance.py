"""The tolerance curve: it falls on what moves, not on what stands still, and its words and drawing say so."""

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from capture_app.session.reading.reader import Session
from reconstruction.compare.tolerance_study import is_decreasing, tolerable_offset_ms
from reconstruction.report.tolerance_report import write_tolerance_report
from reconstruction.scores.comparison_results import OffsetTolerance
from reconstruction.scores.study_result import Interval, Measure, StudyResult
from reconstruction.scores.tally import Measurements, Tally, measure_depth
from tests.reconstruction.conftest import PERIOD_NS, VIEWS, Reconstruct, Scene, write_session
from tests.reconstruction.found import values


def point(ms: float, value: float, low: float | None = None, high: float | None = None) -> StudyResult[Any]:
    moving = Measure(name="mover_coverage", offset=Interval(value=value, low=low, high=high))
    still = Measure(name="static_coverage", offset=Interval(value=0.9))
    return StudyResult(
        name="stereo", cameras=("a", "b"), instants=5, offsets_ms={"a": 0, "b": ms}, measures=(moving, still)
    )


def test_a_curve_falls_unless_a_point_rises_beyond_both_intervals() -> None:
    falling = [point(0, 0.9), point(17, 0.2, 0.1, 0.3), point(33, 0.25, 0.2, 0.4)]
    rising = [*falling[:2], point(33, 0.5, 0.4, 0.6)]
    assert is_decreasing(falling, "mover_coverage")
    assert not is_decreasing(rising, "mover_coverage")


def test_what_is_borne_is_the_first_limit_that_is_reached() -> None:
    points = [point(0, 0.8), point(20, 0.4)]
    assert tolerable_offset_ms(points, "mover_coverage", None) == pytest.approx(4.0)
    assert tolerable_offset_ms(points, "mover_coverage", 0.5) == pytest.approx(2.0)
    assert tolerable_offset_ms([point(0, 0.8), point(20, 0.79)], "mover_coverage", None) is None


def test_the_session_s_own_error_is_marked_where_it_lies_on_the_drawing(tmp_path: Path) -> None:
    def drawing(sync_residual_us: float | None) -> str:
        tolerance = OffsetTolerance(
            cameras=("a", "b"),
            measure="mover_coverage",
            points=(point(0, 0.9, 0.8, 1.0), point(33, 0.1)),
            instants=5,
            decreasing=True,
            sync_residual_us=sync_residual_us,
        )
        page = write_tolerance_report(tolerance, tmp_path).read_text("utf-8")
        drawn = re.findall(r"<svg.*?</svg>", page, re.DOTALL)
        assert len(drawn) == 1
        return " ".join(ElementTree.fromstring(drawn[0]).itertext())

    assert "this session" in drawing(1500.0)
    assert "this session" not in drawing(50_000.0)
    assert "this session" not in drawing(None)


def test_intervals_hold_the_value_and_pairs_are_drawn_together() -> None:
    rng = np.random.default_rng(3)
    moving, static = np.ones((20, 20), bool), np.zeros((20, 20), bool)
    unknown = np.full((20, 20), np.nan)
    tally = Tally()
    for share in rng.uniform(0.2, 0.9, 12):
        good = np.zeros((20, 20))
        good.flat[: round(400 * share)] = 1.0
        worse = good.copy()
        worse.flat[:40] = 0.0
        measured = {"synced": Measurements(), "offset": Measurements()}
        for side, depth in zip(measured, (good, worse), strict=True):
            for kind, mask in (("mover", moving), ("static", static)):
                measured[side].update(measure_depth(depth, unknown, mask, None), f"{kind}_")
        tally.add(measured, {"instant": tally.instants})
    (found,) = (one for one in tally.measures if one.name == "mover_coverage")
    assert found.synced is not None
    low, high = found.synced.ends
    assert low < found.synced.value < high
    # The instants differ much, the pairs hardly: every one has lost the same tenth.
    assert found.difference is not None
    assert found.difference.ends == pytest.approx((-0.1, -0.1))
    assert high - low > 0.1


@pytest.mark.slow
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


@pytest.mark.slow
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


def test_an_unknown_camera_is_refused_in_one_line(
    tmp_path: Path, reconstruct: Reconstruct, boards: Session
) -> None:
    done = reconstruct("tolerance", boards.folder, "--pair", "left,nobody", "--out", tmp_path / "out")
    assert done.code == 3
    assert "no camera 'nobody'" in done.complaint
    assert not (tmp_path / "out").exists()
