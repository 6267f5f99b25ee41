"""The tolerance curve: it falls on what moves, not on what stands still, and its words and drawing say so."""

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from capture_app.session.reading.reader import Session
from reconstruction.compare.tolerance_study import is_decreasing, tolerable_offset_ms
from reconstruction.method.comparison_results import OffsetTolerance
from reconstruction.method.study_result import Interval, Measure, StudyResult
from reconstruction.method.tally import Measurements, Tally, measure_depth
from reconstruction.report.tolerance_report import write_tolerance_report
from tests.unit.reconstruction.conftest import Reconstruct


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


def test_an_unknown_camera_is_refused_in_one_line(
    tmp_path: Path, reconstruct: Reconstruct, boards: Session
) -> None:
    done = reconstruct("tolerance", boards.folder, "--pair", "left,nobody", "--out", tmp_path / "out")
    assert done.code == 3
    assert "names nobody, which the recording lacks" in done.complaint
    assert not (tmp_path / "out").exists()
