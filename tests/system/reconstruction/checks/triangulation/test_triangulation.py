"""Points that COLMAP places under the rig's poses: on what moves many when synchronized, few when not."""

import sys
from pathlib import Path
from typing import Any

import cv2
import pytest

from capture_app.common.errors import NotAvailableError
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.reading.reader import Session
from reconstruction.checks.triangulation.triangulation_study import TriangulationStudy
from reconstruction.method.comparison_results import CompareResult
from reconstruction.method.score import Context
from reconstruction.method.study_result import StudyResult
from reconstruction.methods.stereo.stereo_study import StereoStudy
from reconstruction.scene.conditions import SYNCED, Condition, nearest_frame_offset
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene as OpenScene
from tests.imported import import_one
from tests.unit.reconstruction.conftest import VIEWS, Reconstruct, Scene, make_view, write_session
from tests.unit.reconstruction.found import study as found_study
from tests.unit.reconstruction.found import values

PAIR = {name: VIEWS[name] for name in ("left", "right")}


def study(session: Session, offset_ms: float = 66, max_instants: int = 16) -> TriangulationStudy:
    dataset = Dataset(session)
    offset = nearest_frame_offset(dataset.instants_ns, dataset.period_ns, offset_ms)
    opened = OpenScene(dataset)
    context = Context(scene=opened, step=offset.step, offset=offset, max_instants=max_instants)
    depth = StereoStudy(context)
    depth.prepare()
    points = TriangulationStudy(context)
    points.known = CompareResult(studies=(StudyResult(name="stereo", cameras=depth.cameras),))
    return points


def compared(points: TriangulationStudy, condition: Condition | None = None) -> StudyResult[Any]:
    points.prepare()
    return points.compare(condition or points.condition)


def test_lateness_costs_points_on_movers_and_none_on_the_control(boards: Session) -> None:
    points = study(boards, max_instants=2)
    found = compared(points)
    assert found.cameras == ("left", "right", "aside")
    moving, still = found.first_known("mover_points"), found.first_known("static_points")
    assert moving is not None
    assert still is not None
    assert moving[1] > 20
    assert moving[2] < 0.5 * moving[1]
    assert still[1] == pytest.approx(still[2], rel=0.1)
    assert found.instants == len(found.per_instant) == 2
    together = points.compare(Condition(SYNCED))
    assert together.value("mover_points", "offset") == together.value("mover_points")


def test_of_two_cameras_the_second_is_late(scene: Scene, tmp_path: Path) -> None:
    session = write_session(tmp_path / "pair", scene, PAIR)
    found = compared(study(session, max_instants=3))
    assert found.offsets_ms["left"] == 0
    assert found.offsets_ms["right"] == pytest.approx(66.7, abs=0.1)
    (placed,) = (one for one in found.measures if one.name == "mover_points")
    assert placed.difference is not None
    assert placed.difference.ends[1] < -10
    assert (found.value("mover_precision") or 0) > 0.9
    assert (found.value("mover_precision", "offset") or 0) < 0.3
    still = found.first_known("static_precision")
    assert still is not None
    assert still[1] == pytest.approx(still[2], abs=0.05)


def test_a_short_burst_makes_every_second_camera_late(scene: Scene, tmp_path: Path) -> None:
    session = write_session(tmp_path / "short", scene, VIEWS, instants=2, truth=False)
    found = compared(study(session, offset_ms=33))
    assert {c for c, late in found.offsets_ms.items() if late} == {"right"}


def test_many_cameras_are_thinned_to_those_beside_the_pair(scene: Scene, tmp_path: Path) -> None:
    row = {f"cam{k}": make_view((0.1 * k - 0.25, 0.0, 0.0), yaw=3.75 - 1.5 * k) for k in range(6)}
    session = write_session(tmp_path / "row", scene, row, instants=2, truth=False)
    points = study(session, offset_ms=33)
    points.prepare()
    found = points.compare(Condition(SYNCED))
    assert len(found.cameras) == 5
    assert set(points.known.study("stereo").cameras) < set(found.cameras)
    assert len(found.facts["left_out"]) == 1


def test_what_cannot_be_measured_is_said(
    scene: Scene, tmp_path: Path, reconstruct: Reconstruct, monkeypatch: pytest.MonkeyPatch
) -> None:
    blank = Scene([], noise=1.0)
    session = write_session(tmp_path / "blank", blank, PAIR, instants=3, truth=False)
    points = study_without_pair(session)
    with pytest.raises(ValueError, match="no point that two of left, right see"):
        compared(points)
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    session = write_session(tmp_path / "pair", scene, PAIR, instants=3, truth=False)
    with pytest.raises(NotAvailableError, match="needs pycolmap"):
        compared(study(session))
    result = reconstruct(
        "compare", session.folder, "--max-instants", 1, "--out", tmp_path / "out", "--json"
    ).result
    assert "pycolmap" in found_study(result, "triangulation")["skipped"]
    assert not found_study(result, "stereo")["skipped"]


def study_without_pair(session: Session) -> TriangulationStudy:
    dataset = Dataset(session)
    offset = nearest_frame_offset(dataset.instants_ns, dataset.period_ns, 33)
    opened = OpenScene(dataset)
    return TriangulationStudy(Context(scene=opened, step=offset.step, offset=offset, max_instants=1))


def test_a_comparison_shows_the_points(scene: Scene, tmp_path: Path, reconstruct: Reconstruct) -> None:
    session = write_session(tmp_path / "pair", scene, PAIR, instants=4, truth=False)
    out = tmp_path / "out"
    arguments = ("--max-instants", 1, "--condition", "right=33", "--out", out, "--json")
    result = reconstruct("compare", session.folder, *arguments).result
    points = found_study(result, "triangulation")
    assert points["skipped"] == ""
    synced, offset = (values(points, side)["mover_points"] for side in ("synced", "offset"))
    assert synced > 2 * offset
    (table,) = (one for one in result["words"]["tables"] if "COLMAP" in one["caption"])
    assert table["rows"][0][:3] == ["Points in space", f"{synced:.0f}", f"{offset:.0f}"]
    late = found_study(result["conditions"][0], "triangulation")
    assert values(late, "offset")["mover_points"] < synced
    (picture,) = points["pictures"]
    dots = [cv2.imread(str(out / picture[side])) for side in ("synced", "offset")]
    assert dots[0].shape == dots[1].shape == (240, 320, 3)
    # Coloured dots on what moves are there only at one instant.
    page = (out / "report.html").read_text()
    assert "Points by COLMAP from 2 cameras" in page
    assert "fit by chance are in the wrong place" in page


@pytest.mark.shared
def test_a_real_ball_is_a_point_only_when_synchronized(shared: Path, tmp_path: Path) -> None:
    folder = shared / "footage" / "ball_launch"
    options = ImportOptions(fps=60, calibration=(str(folder / "calibration"),), unit="in")
    session = import_one([str(folder)], tmp_path, "ball", options)
    found = compared(study(session))
    synced, offset = (
        sum(row[f"{side}_mover_points"] or 0 for row in found.per_instant) for side in ("synced", "offset")
    )
    assert synced >= 5
    assert offset <= 1
    assert found.value("static_points") == pytest.approx(found.value("static_points", "offset"), rel=0.1)
