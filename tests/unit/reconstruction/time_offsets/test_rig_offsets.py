"""Offsets of all cameras from those of pairs, and the command that measures them."""

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from reconstruction.common.templates import render_lines
from reconstruction.scene.scene import Scene
from reconstruction.time_offsets.crossings import InstantOffset, OffsetFit
from reconstruction.time_offsets.instant_votes import Change, Step
from reconstruction.time_offsets.rig_offsets import (
    adjust_offsets,
    likely_pairs,
    with_changes,
    with_own_changes,
)
from reconstruction.time_offsets.session_offsets import TimeResult
from tests.unit.reconstruction.conftest import Reconstruct, make_view

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
    result = TimeResult(
        session="s", reference="a", cameras=told | {"d": found["d"]}, calibration="", seconds=1
    )
    lines = render_lines("times.txt", "reconstruction.commands", result=result)[4:]
    assert lines[0] == "a is one frame later than the others from instant 20 on"
    assert lines[1].startswith("d's frames wander by ± 2")


def test_cameras_are_measured_against_those_that_look_the_same_way() -> None:
    yaws = {"a": 0.0, "b": 3.0, "c": 7.0, "d": 12.0, "e": 18.0, "aside": 90.0}
    views = {name: make_view((0, 0, 0), yaw=yaw) for name, yaw in yaws.items()}
    dataset = SimpleNamespace(cameras=[*yaws, "uncalibrated"])
    pairs = likely_pairs(cast("Scene", SimpleNamespace(views=views, dataset=dataset)))
    # Each with its three nearest, which a and e are not for each other; aside sees nothing of theirs.
    assert ["".join(pair) for pair in pairs] == ["ab", "ac", "ad", "bc", "bd", "be", "cd", "ce", "de"]


def test_an_unknown_reference_is_refused_in_one_line(tmp_path: Path, reconstruct: Reconstruct) -> None:
    done = reconstruct("time", tmp_path / "nothing", "--reference", "left")
    assert done.code == 3
    assert "no session" in done.complaint


def test_a_moved_camera_is_named_once_and_as_the_reference_too() -> None:
    text = "a itself was moved by 4.2 pixels before instant 14: only instants 15 to 29 are measured"
    measured = {("a", "b"): OffsetFit(0.1, 0.5, moved={"a": text})}
    for reference in "ab":
        found = with_changes(adjust_offsets("ab", reference, measured), measured, 33.3)
        result = TimeResult(session="s", reference=reference, cameras=found, calibration="", seconds=1)
        assert render_lines("times.txt", "reconstruction.commands", result=result).count(text) == 1
