"""Offsets of all cameras from those of pairs, and the command that measures them."""

from dataclasses import replace
from pathlib import Path

import pytest

from reconstruction.compare.comparison import CompareOptions, compare
from reconstruction.method.comparison_results import CompareResult
from reconstruction.method.timing import measure_pair_timing, measure_rig_timing
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene as OpenScene
from reconstruction.time_offsets.pair_offset import PairOffsets
from tests.unit.reconstruction.conftest import PERIOD_NS, Reconstruct, Scene, make_view, write_session


def test_the_command_tells_every_camera_s_lateness(
    scene: Scene, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    falling = replace(
        scene,
        boards=[
            *scene.boards[:-1],
            replace(scene.boards[-1], path=lambda t: (0.05 * t - 0.2, 0.3 - 0.15 * t)),
        ],
    )
    views = {
        "left": make_view((-0.1, 0.0, 0.0), yaw=1.5),
        "middle": make_view((0.0, -0.05, 0.0)),
        "right": make_view((0.1, 0.01, 0.0), yaw=-1.5),
        "away": make_view((0.1, 0.0, 0.0), yaw=85),
    }
    late = {"middle": 0.4, "right": -1.2}
    session = write_session(tmp_path, falling, views, instants=5, truth=False, late=late)
    result = reconstruct("time", session.folder, "--json").result
    assert result["reference"] == "left"
    for name, periods in late.items():
        found = result["cameras"][name]
        assert abs(found["offset_ms"] - periods * PERIOD_NS / 1e6) < 3 * found["sd_ms"] < 4
        assert found["source"] == "motion"
        assert "left" in found["against"]
    assert "offset_ms" not in result["cameras"]["away"]
    assert result["cameras"]["away"]["reason"]


def test_a_rig_is_together_only_without_its_late_camera(scene: Scene, tmp_path: Path) -> None:
    views = {
        name: make_view((x, 0.02 * (name == "b"), 0)) for name, x in (("a", -0.12), ("b", 0), ("c", 0.12))
    }
    session = write_session(tmp_path, scene, views, instants=6, truth=False, late={"c": 1.0})
    opened = OpenScene(Dataset.open(session.folder))
    offsets = PairOffsets(opened)
    pair = measure_pair_timing(offsets, ("b", "a"))
    found = measure_rig_timing(offsets, pair.cameras)
    assert found.reference == "b"
    assert found.together == {"a", "b"}
    late = next(one for one in found.cameras if one.other == "c")
    assert late.late_ms == pytest.approx(PERIOD_NS / 1e6, abs=1.0)
    assert late.option.startswith("--time-shift-ms c=3")
    for cameras, together in (("ab", True), ("bc", False), ("abc", False)):
        result = CompareResult(timing=pair, rig_timing=found)
        assert result.together(cameras) == together
        assert result.apart(cameras) != together
    assert not CompareResult(timing=pair).together("abc")
    # The pair's first camera is the odd one: the others are not called early.
    other = measure_rig_timing(offsets, ("c", "a"))
    assert other.reference == "a"
    assert other.together == {"a", "b"}


def test_the_headline_names_the_camera_that_is_late(scene: Scene, tmp_path: Path) -> None:
    views = {
        name: make_view((x, 0.02 * (name == "b"), 0)) for name, x in (("a", -0.12), ("b", 0), ("c", 0.12))
    }
    for late in "ac":
        folder = tmp_path / late
        session = write_session(folder, scene, views, instants=6, truth=False, late={late: 1.0})
        options = CompareOptions.of(studies=("stereo",), max_instants=2)
        result = compare(session.folder, folder / "compared", options)
        assert f"{late}'s pictures were taken 33." in result.verdict
        assert "later than" in result.verdict
        assert (
            result.verdict.count("--time-shift-ms") == result.verdict.count(f"--time-shift-ms {late}=") == 1
        )
