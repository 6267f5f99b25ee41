"""Conditions as data: lists of offsets, drawn ones, another session, each beside the synchronized one."""

from pathlib import Path

import pytest

from capture_app.common.errors import BadInputError
from capture_app.session.reading.reader import Session
from reconstruction.scene.conditions import DISTINCT, DISTINCT_MS, SYNCED, Condition
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.instant_choice import instants_shown, pair_instants, refuse_synchronized
from tests.unit.reconstruction.conftest import VIEWS, Reconstruct, Scene, write_session


def test_conditions_are_read_from_text() -> None:
    names = ["cam00", "cam01", "cam02", "cam03"]
    assert Condition.parse("synced").offsets_ms(names, 3) == ()
    assert Condition.parse("66").offsets_ms(names, 3) == (0, 66, 0, 66)
    assert Condition.parse("0,-33,5").offsets_ms(names[:3], 3) == (0, -33, 5)
    named = Condition.parse("cam02=66, cam00=-33.5")
    assert named.offsets_ms(names, 3) == (-33.5, 0, 66, 0)
    assert "/" not in named.name
    kept = Condition.parse("66@cam01")
    assert kept.offsets_ms(names, 3) == (-66, 0, -66, 0)
    for text in ("synced", "66", "0,-33.5", "cam00=1,cam02=-2", "distinct", "distinct@cam01", "66@cam01"):
        assert Condition.parse(text).option == text
        assert Condition.parse(Condition.parse(text).option) == Condition.parse(text)
    for text in ("", "late", "1,,2", "nan", "inf", "cam00=", "cam00=1,2", "cam00=1,cam00=2", "=3"):
        with pytest.raises(BadInputError, match="is not a condition"):
            Condition.parse(text)


@pytest.mark.parametrize("count", [2, 5, 8])
def test_drawn_offsets_are_distinct_as_far_as_they_go(count: int) -> None:
    names = [f"cam{i:02d}" for i in range(count)]
    distinct = Condition(DISTINCT)
    draws = [distinct.offsets_ms(names, instant) for instant in range(20)]
    assert all(len(draw) == count and len(set(draw)) == min(count, len(DISTINCT_MS)) for draw in draws)
    assert all(set(draw) <= set(DISTINCT_MS) for draw in draws)
    assert len(set(draws)) > 5
    assert draws == [distinct.offsets_ms(names, instant) for instant in range(20)]


def test_the_reference_shows_the_same_picture_in_every_condition(boards: Session) -> None:
    dataset = Dataset(boards)
    for instant in range(5):
        shown = instants_shown(dataset, Condition(DISTINCT).kept_at("right"), instant)
        assert shown["right"] == instant
        assert len(set(shown.values())) == 3
    listed = instants_shown(dataset, Condition.parse("66,33,0").kept_at("right"), 1)
    assert listed == {"left": 2, "right": 1, "aside": 0}
    assert instants_shown(dataset, Condition(SYNCED).kept_at("left"), 2) == {
        "left": 2,
        "right": 2,
        "aside": 2,
    }
    with pytest.raises(BadInputError, match=r"no instant is -33 ms from instant 0.*; instant 1 has one"):
        instants_shown(dataset, Condition.parse("66,33,0").kept_at("right"), 0)


def test_a_condition_that_is_none_is_refused() -> None:
    together, apart = (2, {"a": 2, "b": 2}), (2, {"a": 2, "b": 3})
    refuse_synchronized(Condition(SYNCED), [together])
    refuse_synchronized(Condition(DISTINCT), [together, apart])
    with pytest.raises(ValueError, match="too far apart for offsets of up to 66 ms"):
        refuse_synchronized(Condition(DISTINCT), [together])
    with pytest.raises(ValueError, match="equally late"):
        refuse_synchronized(Condition.parse("5,5"), [together, together])


def test_a_burst_that_is_too_short_to_draw_from_is_said(scene: Scene, tmp_path: Path) -> None:
    short = Dataset(write_session(tmp_path, scene, VIEWS, instants=2, truth=False))
    with pytest.raises(BadInputError, match="too short to draw"):
        instants_shown(short, Condition(DISTINCT).kept_at("left"), 0)


def test_a_pair_sees_the_difference_of_its_offsets_in_either_direction(boards: Session) -> None:
    dataset = Dataset(boards)
    condition = Condition.parse("left=66,right=33")
    early, early_ms = pair_instants(dataset, condition, "left", "right")
    late, late_ms = pair_instants(dataset, condition, "right", "left")
    assert early == [(1, 0), (2, 1), (3, 2), (4, 3)]
    assert late == [(0, 1), (1, 2), (2, 3), (3, 4)]
    assert (early_ms, late_ms) == (pytest.approx(-33.3, abs=0.1), pytest.approx(33.3, abs=0.1))
    with pytest.raises(ValueError, match="equally late"):
        pair_instants(dataset, Condition.parse("left=66,right=66"), "left", "right")
    drawn, drawn_ms = pair_instants(dataset, Condition(DISTINCT), "left", "right")
    assert drawn_ms is None
    assert [now for now, _ in drawn] == [0, 1, 2, 3, 4]
    assert all(now != later for now, later in drawn)


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        ("left=66,nobody=0", 3, "names nobody, which the recording lacks"),
        ("66,33", 3, "2 offsets for 3 cameras"),
        ("left", 2, "cam00=0"),
        ("left=soon", 2, "cam00=0"),
        ("synced", 2, "part of every comparison"),
    ],
)
def test_wrong_lists_are_one_line(
    boards: Session, tmp_path: Path, reconstruct: Reconstruct, text: str, code: int, words: str
) -> None:
    done = reconstruct("compare", boards.folder, "--condition", text, "--out", tmp_path / "out")
    assert done.code == code
    assert words in done.complaint
    assert done.err.splitlines() == [done.complaint]
    assert not (tmp_path / "out").exists()
