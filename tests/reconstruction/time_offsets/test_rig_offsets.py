"""Offsets of all cameras from those of pairs, and the command that measures them."""

from dataclasses import replace
from pathlib import Path

import pytest

from reconstruction.commands.time import change_lines
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene as OpenScene
from reconstruction.scores.comparison_results import CompareResult
from reconstruction.scores.timing import measure_pair_timing, measure_rig_timing
from reconstruction.time_offsets.crossings import InstantOffset, OffsetFit
from reconstruction.time_offsets.instant_votes import Change, Step
from reconstruction.time_offsets.pair_offset import PairOffsets
from reconstruction.time_offsets.rig_offsets import adjust_offsets, with_changes, with_own_changes
from tests.reconstruction.conftest import PERIOD_NS, Reconstruct, Scene, make_view, write_session

NOTHING = OffsetFit(reason="too little moves")


def test_pairs_are_adjusted_by_their_errors() -> None:
    measured = {
        ("a", "b"): OffsetFit(10.0, 0.5),
        ("b", "c"): OffsetFit(-4.0, 0.5, misfit_px=8.0),
        ("a", "c"): OffsetFit(8.0, 5.0),
        ("c", "d"): NOTHING,
        ("e", "f"): OffsetFit(1.0, 0.5),
    }
    found = adjust_offsets("abcdef", None, measured)
    assert found["a"].offset_ms == 0
    assert found["b"].offset_ms == pytest.approx(10.0, abs=0.1)
    assert found["c"].offset_ms == pytest.approx(6.0, abs=0.1)
    assert found["c"].sd_ms is not None
    assert 0.5 < found["c"].sd_ms < 1
    assert found["c"].misfit_px == 8.0
    assert found["d"].offset_ms is None
    assert found["d"].reason == "too little moves"
    assert found["e"].offset_ms is None
    assert "whose own offset is not known" in found["e"].reason
    turned = adjust_offsets("abcdef", "c", measured)
    assert turned["a"].offset_ms == pytest.approx(-6.0, abs=0.1)


def test_pairs_that_contradict_each_other_widen_the_error() -> None:
    sure = {("a", "b"): OffsetFit(10.0, 0.5), ("b", "c"): OffsetFit(5.0, 0.5)}
    agreed, contradicted = (
        adjust_offsets("abc", "a", {**sure, ("a", "c"): OffsetFit(ms, 0.5)})["c"] for ms in (15.0, 25.0)
    )
    assert agreed.sd_ms is not None
    assert contradicted.sd_ms is not None
    assert contradicted.sd_ms > 5 * agreed.sd_ms


def test_changes_and_wandering_images_are_told_of_the_camera_that_has_them() -> None:
    late = Change(steps=(Step(20, 1, 19, 21),))
    wander = tuple(InstantOffset(k, ms, 0.5, 20) for k, ms in enumerate((9, -8, 7, -9, 8, -7.0)))
    measured = {
        ("a", "b"): OffsetFit(0.0, 0.5, change=late.reversed()),
        ("a", "c"): OffsetFit(0.0, 0.5, change=late.reversed()),
        ("b", "c"): OffsetFit(0.0, 0.5),
        ("b", "d"): OffsetFit(0.0, 0.5, instants=wander),
    }
    found = with_changes(adjust_offsets("abcd", "b", measured), measured, 33.3)
    assert found["a"].change == late
    assert {name for name, one in found.items() if one.change} == {"a"}
    assert found["d"].jitter_ms == pytest.approx(11.4, abs=1)
    assert [one.jitter_ms for one in found.values()][:3] == [None] * 3
    told = with_own_changes(with_changes(adjust_offsets("abc", "a", measured), measured, 33.3))
    assert told["a"].change == late
    assert told["b"].change is None
    lines = [*change_lines("a", told | {"d": found["d"]})]
    assert lines[0] == "a is one frame later than the others from instant 20 on"
    assert lines[1].startswith("d's frames wander by ± 2")


@pytest.mark.slow
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


def test_an_unknown_reference_is_refused_in_one_line(tmp_path: Path, reconstruct: Reconstruct) -> None:
    done = reconstruct("time", tmp_path / "nothing", "--reference", "left")
    assert done.code == 3
    assert "no session" in done.complaint


@pytest.mark.slow
def test_a_rig_is_together_only_without_its_late_camera(scene: Scene, tmp_path: Path) -> None:
    views = {
        name: make_view((x, 0.02 * (name == "b"), 0)) for name, x in (("a", -0.12), ("b", 0), ("c", 0.12))
    }
    session = write_session(tmp_path, scene, views, instants=6, truth=False, late={"c": 1.0})
    opened = OpenScene(Dataset.open(session.folder))
    offsets = PairOffsets(opened)
    pair = measure_pair_timing(offsets, ("b", "a"))
    found = measure_rig_timing(offsets, pair.reference)
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
