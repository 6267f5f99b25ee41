"""Offsets of all cameras from those of pairs, and the command that measures them."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from capture_app.console.terminal import Progress
from capture_app.session.format.common_times import REFERENCE
from reconstruction.common.templates import render_lines
from reconstruction.scene.scene import Scene
from reconstruction.time_offsets.camera_time import CameraTime
from reconstruction.time_offsets.crossings import InstantOffset, OffsetFit
from reconstruction.time_offsets.instant_votes import UNCHANGED, Change, Step
from reconstruction.time_offsets.pair_offset import PairOffsets
from reconstruction.time_offsets.rig_offsets import (
    MOTION,
    adjust_offsets,
    likely_pairs,
    measure_rig_offsets,
    with_changes,
    with_own_changes,
)
from reconstruction.time_offsets.session_offsets import TimeResult
from reconstruction.time_offsets.single_images import SingleImages
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


class Steps(Progress):
    """Notes the steps that are shown."""

    def __init__(self, total: int) -> None:
        super().__init__(total, silent=True)
        self.texts: list[str] = []

    def step(self, text: str) -> None:
        super().step(text)
        self.texts.append(text)


class Pairs:
    """Offsets of pairs as they are measured, once each."""

    def __init__(self, offsets_ms: dict[str, float]) -> None:
        self.offsets_ms, self.asked = offsets_ms, list[tuple[str, str]]()

    def measure_anywhere(self, first: str, second: str) -> OffsetFit:
        self.asked.append((first, second))
        change = Change(steps=(Step(20, 1, 19, 21),)) if second == "c" else UNCHANGED
        return OffsetFit(self.offsets_ms[second] - self.offsets_ms[first], 0.5, change=change)


def test_a_rig_is_measured_by_its_likely_pairs_and_each_step_is_shown() -> None:
    views = {name: make_view((0.1 * k, 0, 0), yaw=5 * k) for k, name in enumerate("abc")}
    dataset = SimpleNamespace(cameras=("a", "b", "c"), period_ns=33_300_000)
    scene = cast("Scene", SimpleNamespace(views=views, dataset=dataset))
    pairs, progress = Pairs({"a": 1.0, "b": 4.0, "c": 9.0}), Steps(20)
    found = measure_rig_offsets(scene, "b", progress, finder=cast("PairOffsets", pairs))
    assert {name: round(time.offset_ms or 0.0, 6) for name, time in found.items()} == {
        "a": -3,
        "b": 0,
        "c": 5,
    }
    assert found["c"].change
    assert not found["a"].change
    assert sorted(pairs.asked) == [("a", "b"), ("a", "c"), ("b", "c")]
    assert sorted(progress.texts) == ["b against a", "c against a", "c against b"]
    # One step is left, and those of pairs that see nothing in common are skipped.
    assert (progress.done, progress.total) == (19, 20)
    preferred = measure_rig_offsets(scene, preferred="c", finder=cast("PairOffsets", pairs))
    assert preferred["c"].source == "reference"


def test_a_change_that_all_others_have_is_the_references() -> None:
    late = Change(steps=(Step(20, 1, 19, 21),))

    def camera(change: Change | None, source: str = MOTION) -> CameraTime:
        return CameraTime(offset_ms=0.0, sd_ms=0.1, source=source, change=change)

    rig = {"a": camera(None, REFERENCE), "b": camera(late), "c": camera(late)}
    own = with_own_changes(rig)
    assert own["a"].change == late.reversed()
    assert own["b"].change is own["c"].change is None
    # Of two cameras nobody knows which has it, nor where the others differ, or one of them has none.
    for others in ({"b": camera(late)}, {"b": camera(None), "c": camera(late)}):
        kept = {"a": camera(None, REFERENCE), **others}
        assert with_own_changes(kept) == kept
    later = Change(steps=(Step(40, 1, 39, 41),))
    two = {"a": camera(None, REFERENCE), "b": camera(late), "c": camera(late.followed_by(later))}
    assert {name for name, own in with_own_changes(two).items() if own.change} == {"b", "c"}
    three = two | {"d": camera(later)}
    assert with_own_changes(three) == three
    unknown = rig | {"d": CameraTime(reason="it has no calibration")}
    assert with_own_changes(unknown)["a"].change == late.reversed()


def test_what_single_images_show_is_of_a_camera_in_all_its_pairs() -> None:
    measured = {
        ("a", "b"): OffsetFit(0.0, 0.5, rows_ms=-8.0, repeats_ms=700.0, screens=("b",), unvoted=(3, 5, 6)),
        ("a", "c"): OffsetFit(0.0, 0.5, rows_ms=-5.0, unvoted=(5, 6, 7), moved={"a": "a itself was moved"}),
        ("b", "c"): OffsetFit(0.0, 0.5, rows_ms=1.0, repeats_ms=700.0, unvoted=(6,)),
    }
    found = with_changes(adjust_offsets("abc", "b", measured), measured, 33.3)
    assert (found["a"].images.rows_ms, found["c"].images.rows_ms, found["b"].images.rows_ms) == (5, 1, -1)
    assert (found["a"].images.repeats_ms, found["b"].images.repeats_ms) == (0, 700)
    assert (found["a"].images.unvoted, found["a"].images.examined) == ((5, 6), 3)
    assert [found[name].images.screens for name in "abc"] == [("b",), ("b",), ()]
    assert [found[name].images.moved for name in "abc"] == [("a itself was moved",), (), ()]
    assert found["a"].images.period_ms == 33.3
    # Nor does a pair whose offset is unknown.
    unknown = measured | {("c", "d"): NOTHING}
    assert with_changes(adjust_offsets("abcd", "b", unknown), unknown, 33.3)["d"].images == SingleImages()
    # A lone pair says nothing of its reference; the other one has it.
    alone = {("a", "b"): measured["a", "b"]}
    pair = with_changes(adjust_offsets("ab", "a", alone), alone, 33.3)
    assert (pair["a"].images.rows_ms, pair["b"].images.rows_ms) == (0, -8)


def test_images_that_are_odd_in_all_pairs_are_named_unless_something_explains_them() -> None:
    def track(*late_ms: float) -> tuple[InstantOffset, ...]:
        return tuple(InstantOffset(k, ms, 0.5, 20) for k, ms in enumerate(late_ms))

    odd = OffsetFit(2.0, 0.5, instants=track(2, 2, 12, 2))
    measured = {("a", "b"): odd, ("b", "c"): odd.later(-4), ("a", "c"): OffsetFit(0.0, 0.5)}
    found = with_changes(adjust_offsets("abc", "a", measured), measured, 33.3)
    assert found["b"].images.odd_ms == {}
    measured["b", "c"] = OffsetFit(-2.0, 0.5, instants=track(-2, -2, -9, -2))
    found = with_changes(adjust_offsets("abc", "a", measured), measured, 33.3)
    assert found["b"].images.odd_ms == {2: 10}
    wander = track(*[0.0, 9, -9, 9, -9, 9, -9, 12])
    shaken = {pair: replace(fit, instants=wander) for pair, fit in measured.items() if pair != ("a", "c")}
    found = with_changes(adjust_offsets("abc", "a", shaken), shaken, 33.3)
    assert found["b"].jitter_ms
    assert found["b"].images.odd_ms == {}
    stepped = replace(odd, change=Change(steps=(Step(20, 1, 19, 21),)))
    changed = measured | {("a", "b"): stepped}
    assert with_changes(adjust_offsets("abc", "a", changed), changed, 33.3)["b"].images.odd_ms == {}


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
