"""Conditions: what is asked for, each camera's delay by it, and the instants that it shows."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import numpy as np
import pytest

from capture_app.common.errors import BadInputError, NotApplicableError
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.common_times import CommonTimes
from capture_app.session.format.manifest import BurstRecord, CameraRecord
from capture_app.session.reading.reader import Session
from reconstruction.scene.conditions import (
    ALL_APART,
    DISTINCT_MS,
    SYNCHRONIZED,
    Condition,
    FrameOffset,
    evenly_spaced,
    nearest_frame_offset,
)
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.instant_choice import (
    ShownInstant,
    choose_moving_instants,
    complete_instants,
    fixed_offsets_ms,
    instants_shown,
    pair_instants,
    relative_offsets_ms,
)
from tests.facts import make_facts
from tests.unit.reconstruction.conftest import Scene, make_view, write_session

CAMERAS = ("a", "b", "c")


@pytest.mark.parametrize(
    ("text", "name", "offsets_ms"),
    [
        ("synced", "synced", ()),
        ("66", "66ms", (0, 66, 0)),
        (" 0,66,-33.5 ", "0_66_-33.5ms", (0, 66, -33.5)),
        ("c=33, a = -5", "c=33_a=-5ms", (-5, 0, 33)),
        ("0,66,33@b", "0_66_33ms@b", (-66, 0, -33)),
        ("b=66 @ b", "b=66ms@b", (-66, 0, -66)),
    ],
)
def test_a_condition_is_each_cameras_delay(text: str, name: str, offsets_ms: tuple[float, ...]) -> None:
    condition = Condition.parse(text)
    assert (condition.name, condition.offsets_ms(CAMERAS, 4)) == (name, offsets_ms)
    assert Condition.parse(condition.option) == condition
    assert not condition.drawn


def test_drawn_delays_are_those_of_their_instant_and_all_differ() -> None:
    condition = Condition.parse("distinct")
    assert condition == ALL_APART
    assert (condition.drawn, condition.option) == (True, "distinct")
    drawn = [condition.offsets_ms(CAMERAS, k) for k in range(6)]
    assert [condition.offsets_ms(CAMERAS, k) for k in range(6)] == drawn
    assert all(len({*each}) == 3 and {*each} <= {*DISTINCT_MS} for each in drawn)
    assert len({*drawn}) > 3
    assert condition.offsets_ms(CAMERAS, 1, draw=1) != drawn[1]
    many = condition.offsets_ms(tuple("abcdefgh"), 1)
    assert (len(many), len({*many[:5]}), many[:3]) == (8, 5, drawn[1])
    kept = condition.kept_at("b")
    assert (kept.name, kept.option, kept.drawn) == ("distinct@b", "distinct@b", True)
    assert kept.offsets_ms(CAMERAS, 1)[1] == 0
    assert kept.offsets_ms(CAMERAS, 1)[0] == drawn[1][0] - drawn[1][1]
    assert kept.kept_at("c").name == "distinct@c"
    assert SYNCHRONIZED.kept_at("b") == SYNCHRONIZED


@pytest.mark.parametrize("text", ["", "x", "a=x", "a=1,2", "1,,2", "a=1,a=2", "1e9", "nan", "=3"])
def test_what_is_no_condition_is_refused(text: str) -> None:
    with pytest.raises(BadInputError, match="is not a condition"):
        Condition.parse(text)


def rig(
    *, instants: int = 8, missing: tuple[tuple[str, int], ...] = (), delays_ns: tuple[int, ...] = (0, 0, 0)
) -> Dataset:
    """Three cameras at 30 frames a second, without images' files."""
    facts = make_facts(width=320, height=240, period_ns=33_000_000)
    cameras = [
        CameraRecord(name=name, facts=facts, delay_ns=delay)
        for name, delay in zip(CAMERAS, delays_ns, strict=True)
    ]
    images = [
        SimpleNamespace(
            camera=name, instant=k, leader_ns=33_000_000 * k, substitute=False, sha256=f"{name}{k}"
        )
        for k in range(instants)
        for name in CAMERAS
        if (name, k) not in missing
    ]
    times = tuple(33_000_000 * k for k in range(instants))
    manifest = SimpleNamespace(
        name="rig",
        cameras=cameras,
        labels={"a": "a", "b": "left", "c": "c"},
        burst=BurstRecord(instants_ns=times, period_ns=33_000_000),
        images=images,
        steps="",
        origin="captured",
    )
    session: Any = SimpleNamespace(
        manifest=manifest, camera=lambda name: next(one for one in cameras if one.name == name)
    )
    return Dataset(session)


def test_cameras_may_be_meant_by_their_labels() -> None:
    dataset = rig()
    assert Condition.parse("left=66@left").named(dataset).named_ms == (("b", 66),)
    assert Condition.parse("left=66@left").named(dataset).anchor == "b"
    assert Condition.parse("1,2,3").named(dataset).listed_ms == (1, 2, 3)
    assert Condition.parse("66").named(dataset) == Condition.parse("66")
    for text in ("d=66", "66@d"):
        with pytest.raises(BadInputError, match="d"):
            Condition.parse(text).named(dataset)
    with pytest.raises(BadInputError, match="2 offsets for 3 cameras"):
        Condition.parse("1,2").named(dataset)


def test_each_camera_shows_the_instant_nearest_to_its_delay() -> None:
    dataset = rig()
    assert instants_shown(dataset, SYNCHRONIZED, 3) == {"a": 3, "b": 3, "c": 3}
    assert instants_shown(dataset, Condition.parse("0,60,-33"), 3) == {"a": 3, "b": 5, "c": 2}
    with pytest.raises(BadInputError, match="no instant is -33 ms from instant 0") as refused:
        instants_shown(dataset, Condition.parse("0,66,-33"), 0)
    assert refused.value.hint == "its instants reach from 0 to 231 ms from there; instant 1 has one"
    with pytest.raises(BadInputError, match="no instant is 300 ms") as refused:
        dataset.nearest_instants(2, (0, 300, 0))
    assert refused.value.hint == "its instants reach from -66 to 165 ms from there"
    with pytest.raises(BadInputError, match="no instant 8"):
        dataset.nearest_instants(8, ())
    with pytest.raises(BadInputError, match="2 offsets for 3 cameras"):
        dataset.nearest_instants(1, (0, 1))
    # Half a period from an instant is as near as its images are.
    assert dataset.nearest_instants(0, (0, 16, 247)) == {"a": 0, "b": 0, "c": 7}


def test_drawn_delays_that_count_from_a_camera_are_drawn_until_they_fit() -> None:
    dataset = rig()
    shown = instants_shown(dataset, ALL_APART.kept_at("b"), 0)
    assert (shown["b"], len({*shown.values()})) == (0, 3)
    with pytest.raises(BadInputError, match="too short to draw different offsets around instant 1"):
        instants_shown(rig(instants=2), ALL_APART.kept_at("b"), 1)
    assert fixed_offsets_ms(ALL_APART, dataset) == {}
    assert fixed_offsets_ms(Condition.parse("66"), dataset) == {"a": 0, "b": 66, "c": 0}
    assert relative_offsets_ms(Condition.parse("5,66,33"), dataset, "b", ("a", "b")) == {"a": -61, "b": 0}
    assert relative_offsets_ms(ALL_APART, dataset, "b", CAMERAS) == {}


def test_instants_with_images_of_most_cameras_in_both_conditions_are_complete() -> None:
    """The reference keeps its own image; a is so much earlier, c as much later."""
    dataset = rig(missing=(("a", 2), ("c", 7)))
    late = Condition.parse("0,33,66")
    assert complete_instants(dataset, late, "b", CAMERAS) == [
        ShownInstant(k, {"a": k - 1, "b": k, "c": k + 1}) for k in (1, 4, 5)
    ]
    assert [one.instant for one in complete_instants(dataset, late, "b", ("a", "b"))] == [1, 4, 5, 6]
    # Fewer cameras have images at both only at those that none has more of.
    sparse = rig(missing=tuple(("c", k) for k in range(8)))
    assert complete_instants(sparse, late, "b", CAMERAS, 2)[0].shown == {"a": 0, "b": 1}
    with pytest.raises(ValueError, match="no instant has its pictures in both conditions"):
        complete_instants(sparse, SYNCHRONIZED, "b", CAMERAS, 3)
    with pytest.raises(ValueError, match="no instant is 330 ms from instant 7"):
        complete_instants(dataset, Condition.parse("a=330"), "b", CAMERAS)
    with pytest.raises(ValueError, match="equally late, which is synchronized"):
        complete_instants(dataset, Condition.parse("5,5,5"), "b", CAMERAS)
    assert complete_instants(dataset, SYNCHRONIZED, "b", CAMERAS)[0].together == {"a": 0, "b": 0, "c": 0}
    slow = rig(instants=4)
    slow.instants_ns = tuple(10**9 * k for k in range(4))
    slow.period_ns = 10**9
    with pytest.raises(ValueError, match="too far apart for offsets of up to"):
        complete_instants(slow, ALL_APART, "b", CAMERAS)


def test_a_shown_instant_has_both_conditions_and_its_delays() -> None:
    moment = ShownInstant(2, {"a": 1, "b": 2})
    assert moment.by_condition == {"synced": {"a": 2, "b": 2}, "offset": {"a": 1, "b": 2}}
    assert moment.delays_ms(rig()) == {"offset_a_ms": -33, "offset_b_ms": 0}


def test_a_pair_is_compared_at_instants_that_both_have() -> None:
    dataset = rig(instants=5, missing=(("b", 1),))
    pairs, late_ms = pair_instants(dataset, Condition.parse("0,66,0"), "a", "b")
    assert (pairs, late_ms) == ([(0, 2), (2, 4)], 66)
    pairs, late_ms = pair_instants(dataset, Condition.parse("66,0,0"), "a", "b")
    assert (pairs, late_ms) == ([(2, 0), (4, 2)], -66)
    drawn, late_ms = pair_instants(dataset, ALL_APART, "a", "c")
    assert late_ms is None
    assert all(now != later for now, later in drawn)
    assert drawn
    for text, said in (
        ("b=10,a=10", "a and b are equally late"),
        ("b=400", "too short for an offset of 400 ms"),
        ("b=15", "no two frames of the burst are about 15 ms apart"),
    ):
        with pytest.raises(ValueError, match=said):
            pair_instants(dataset, Condition.parse(text), "a", "b")
    with pytest.raises(ValueError, match="a and b have no images at this offset"):
        pair_instants(rig(instants=2, missing=(("b", 1),)), Condition.parse("b=33"), "a", "b")


def test_an_offset_of_frames_is_the_nearest_that_the_burst_has() -> None:
    times = tuple(33_000_000 * k for k in range(5))
    offset = nearest_frame_offset(times, 33_000_000, 60.0)
    assert (offset.actual_ms, offset.frames, offset.step) == (66, 2, 2)
    assert offset.pairs == ((0, 2), (1, 3), (2, 4))
    assert offset.reversed == FrameOffset(-60.0, -66_000_000, -2, 2, ((2, 0), (3, 1), (4, 2)))
    with pytest.raises(BadInputError, match="one instant only"):
        nearest_frame_offset(times[:1], 33_000_000, 33.0)
    assert nearest_frame_offset(times, 33_000_000, 148.0).frames == 4
    with pytest.raises(BadInputError, match="too short") as refused:
        nearest_frame_offset(times, 33_000_000, 149.0)
    assert refused.value.hint == "the largest offset possible is 132 ms"


def test_items_are_thinned_evenly() -> None:
    assert evenly_spaced("abcde", 5) == [*"abcde"]
    assert evenly_spaced("abcde", 3) == ["a", "c", "e"]
    assert evenly_spaced("abcdef", 1) == ["d"]


def test_instants_at_which_all_cameras_see_motion_are_chosen() -> None:
    def motion(**shares: list[float]) -> Any:
        pixels = {name: [np.arange(20_000) < share * 20_000 for share in of] for name, of in shares.items()}
        return SimpleNamespace(detected_moving=lambda name, k: pixels[name][k])

    both = motion(a=[0, 0.1, 0.1, 1e-4, 0.1, 0.1], b=[0.1, 0.1, 0, 0.1, 0.1, 5e-5])
    assert choose_moving_instants(both, ("a", "b"), range(6), 9) == [1, 3, 4]
    assert choose_moving_instants(both, ("a", "b"), range(6), 2) == [1, 4]
    # Of few, those with the most, however little; where nothing moves, any.
    few = motion(a=[0, 5e-5, 0, 0.1, 1e-4, 0])
    assert choose_moving_instants(few, ("a",), range(6), 9) == [1, 3, 4]
    assert choose_moving_instants(few, ("a",), range(6), 2) == [3, 4]
    assert choose_moving_instants(motion(a=[0] * 6), ("a",), range(6), 2) == [0, 5]


def test_a_staggered_rigs_images_of_one_step_show_one_moment() -> None:
    dataset = rig(delays_ns=(0, 11_000_000, 0))
    assert dataset.steps_ns == {"a": 0, "b": 11_000_000, "c": 0}
    assert rig(delays_ns=(0, 11_000_000, 22_000_000)).steps_ns == {"a": 0, "b": 0, "c": 0}
    assert (dataset.planned_delay_ms("a", "b"), dataset.planned_delay_ms("b", "a")) == (11, -11)


def test_instants_and_cameras_that_there_are_not_are_refused() -> None:
    dataset = rig(instants=3, missing=(("a", 1),))
    assert (dataset.chosen_instants(None), dataset.chosen_instants(())) == ([0, 1, 2], [0, 1, 2])
    assert dataset.chosen_instants([2, 0, 2]) == [0, 2]
    for instant in (-1, 3):
        with pytest.raises(BadInputError, match=f"no instant {instant}") as refused:
            dataset.chosen_instants([1, instant])
    assert refused.value.hint == "it has 0 to 2"
    assert dataset.instants("a", "b") == (0, 2)
    assert dataset.has_images([("a", 0), ("b", 1)])
    assert not dataset.has_images([("a", 0), ("a", 1)])
    dataset.require_cameras(3, "take three")
    with pytest.raises(NotApplicableError, match=r"one camera only \(a, left, c\)"):
        dataset.require_cameras(4, "take four")
    assert dataset.other_labels == {"b": "left"}


def test_a_fingerprint_is_of_all_images_their_size_and_the_calibration() -> None:
    calibration = Calibration(cameras={}, source="a board")
    whole = rig().fingerprint(calibration)
    assert rig().fingerprint(calibration) == whole
    changed, moved, smaller = rig(), rig(), rig()
    cast("Any", changed._records["b", 3]).sha256 = "other"
    moved._records["b", 3], moved._records["b", 4] = moved._records["b", 4], moved._records["b", 3]
    smaller._scale = 0.5
    others = [dataset.fingerprint(calibration) for dataset in (changed, moved, smaller, rig(instants=7))]
    others += [rig().fingerprint(None), rig().fingerprint(msgspec.structs.replace(calibration, source="x"))]
    assert len({whole, *others}) == 7


def test_times_that_share_no_clock_are_said_unless_they_are_shifted(scene: Scene, tmp_path: Path) -> None:
    views = {"a": make_view((0, 0, 0)), "b": make_view((0.1, 0, 0))}
    session = write_session(tmp_path, scene, views, instants=2, truth=False)
    assert Dataset(session).unsynchronized == ""
    times = CommonTimes(state="unknown", reason="each video counts from its own beginning")
    burst = msgspec.structs.replace(session.stored_manifest.burst, common_times=times)
    apart = Session(session.folder, msgspec.structs.replace(session.stored_manifest, burst=burst))
    assert "each video counts" in Dataset(apart).unsynchronized
    assert "each video counts" in Dataset(apart, {"a": 0.0}).unsynchronized
    assert Dataset(apart, {"a": 33.0}).unsynchronized == ""
