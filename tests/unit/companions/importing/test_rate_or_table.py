"""Frames find the frames of the same instant, whatever was dropped and however the table is written."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from capture_app.common.errors import BadInputError
from capture_app.companions.importing.times.rules import timeline_by_rate
from capture_app.companions.importing.times.tables import timeline_by_tables
from capture_app.session.importing.frame_matching import Timeline
from capture_app.session.importing.recording_sources import Source


class Numbers(Source):
    """A camera that is nothing but frame numbers."""

    def __init__(self, name: str, numbers: Sequence[int], numbered: bool = True) -> None:
        self.name, self.numbers = name, numbers
        self.name_numbers = [(number,) for number in numbers] if numbered else ()

    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        raise NotImplementedError


def timeline_by_table(sources: Sequence[Source], path: Path) -> Timeline:
    return timeline_by_tables(sources, [("", path)])[0]


def frames_of(timeline: Timeline) -> list[dict[str, int]]:
    return [{name: frame.index for name, frame in i.frames.items()} for i in timeline.instants]


@pytest.fixture
def table(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str) -> Path:
        path = tmp_path / "times.csv"
        path.write_text(text)
        return path

    return write


def test_equal_numbers_are_one_instant() -> None:
    timeline = timeline_by_rate([Numbers("a", [0, 9, 10]), Numbers("b", [9, 10, 11])], 60)
    assert frames_of(timeline) == [{"a": 0}, {"a": 1, "b": 0}, {"a": 2, "b": 1}, {"b": 2}]
    assert [i.leader_ns for i in timeline.instants] == [0, 150_000_000, 166_666_667, 183_333_333]
    assert timeline.period_ns == 16_666_667


def test_without_numbers_the_order_counts_for_all() -> None:
    timeline = timeline_by_rate([Numbers("a", [5, 6]), Numbers("b", [0, 1], numbered=False)], 25)
    assert frames_of(timeline) == [{"a": 0, "b": 0}, {"a": 1, "b": 1}]


def test_an_odd_rate_does_not_add_up_its_rounding() -> None:
    timeline = timeline_by_rate([Numbers("a", [0, 1_000_000])], 29.97)
    assert timeline.instants[1].leader_ns == round(1_000_000 * 1e9 * 100 / 2997)


@pytest.mark.parametrize("fps", [0.0, -1.0, float("nan"), float("inf")])
def test_a_rate_that_is_none_is_refused(fps: float) -> None:
    with pytest.raises(BadInputError, match="rate"):
        timeline_by_rate([Numbers("a", [0])], fps)


def test_numbers_that_never_meet_are_refused() -> None:
    with pytest.raises(BadInputError, match="no two cameras share"):
        timeline_by_rate([Numbers("a", [0, 1]), Numbers("b", [100, 101])], 60)


def test_caliscope_rows_group_by_sync_index(table: Callable[[str], Path]) -> None:
    path = table(
        "sync_index,cam_id,frame_time\n7,1,100.002\n7,0,100.000\n8,0,100.100\n8,1,\n9,1,100.202\n9,0,100.2\n10,0,100.3\n"
    )
    timeline = timeline_by_table([Numbers("cam_0", range(4)), Numbers("cam_1", range(2))], path)
    assert frames_of(timeline) == [
        {"cam_0": 0, "cam_1": 0}, {"cam_0": 1}, {"cam_0": 2, "cam_1": 1}, {"cam_0": 3},
    ]  # fmt: skip
    first = timeline.instants[0]
    assert first.leader_ns == 100_001_000_000
    assert first.frames["cam_1"].leader_ns == 100_002_000_000
    assert "dropped" in timeline.instants[1].why_missing["cam_1"]
    assert timeline.instants[3].why_missing == {}
    assert timeline.camera_periods_ns == {"cam_0": 100_000_000, "cam_1": 200_000_000}


def test_nanoseconds_are_exact_and_separators_vary(table: Callable[[str], Path]) -> None:
    path = table("Camera;Frame;Time_ns\na;0;1700000000123456789\nb;0;1700000000123456780\n"
                 "a;1;1700000000156789012\nb;1;1700000000156789000\n")  # fmt: skip
    timeline = timeline_by_table([Numbers("a", range(2)), Numbers("b", range(2))], path)
    assert timeline.instants[0].frames["a"].leader_ns == 1_700_000_000_123_456_789
    assert frames_of(timeline) == [{"a": 0, "b": 0}, {"a": 1, "b": 1}]


@pytest.mark.parametrize("numbers", [(25, 26, 27), (1, 2, 3), (7, 9, 12)])
def test_numbers_since_the_cameras_start_give_the_order(
    table: Callable[[str], Path], numbers: Sequence[int]
) -> None:
    """As in Caliscope's frame_index: a's rows are not in order, b's first frame is late."""
    rows = [f"a,{n},{k / 10}\nb,{n + 4},{k / 10 + 0.1}" for k, n in enumerate(numbers)]
    path = table("\n".join(["camera,frame_index,time", *reversed(rows)]))
    sources = [Numbers("a", range(3)), Numbers("b", range(3))]
    timeline, notes = timeline_by_tables(sources, [("", path)])
    assert frames_of(timeline) == [{"a": 0}, {"a": 1, "b": 0}, {"a": 2, "b": 1}, {"b": 2}]
    assert f"(a {numbers[0]} to {numbers[-1]}, b" in notes[0]
    assert notes[0].endswith("its rows are taken in order")


def test_numbers_since_the_start_of_a_camera_with_more_frames_are_refused(
    table: Callable[[str], Path],
) -> None:
    """Those of b could be positions, but a's show that they count from 1."""
    path = table("camera,frame,time\na,1,0\na,2,1\nb,1,0\nb,2,1\n")
    with pytest.raises(BadInputError, match="names frame 2 of camera a, which has 2 frames"):
        timeline_by_tables([Numbers("a", range(2)), Numbers("b", range(3))], [("", path)])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "has the columns"),
        ("camera,time\na,0\n", "has the columns camera, time"),
        ("camera,frame,time\na,0,0\na,1,1\n", "no times of camera b"),
        ("camera,frame,time\na,0,soon\n", "line 2: 'soon' is not a time"),
        ("camera,frame,time\na,first,0\n", "line 2: 'first' is not a frame number"),
        ("camera,frame,time\na,0,0\na,2,1\na,3,2\nb,0,0\nb,1,1\n", "names frame 2 of camera a"),
        ("camera,frame,time\na,0,0\na,0,1\nb,0,0\nb,1,1\n", "frame of camera a twice"),
        ("camera,frame,time\na,0,0\na,1,0\nb,0,0\nb,1,1\n", "camera a has a time twice"),
        ("camera,frame,time\na,0,0\nb,0,0\nb,1,1\n", "only one time"),
        ("camera,sync_index,time\na,0,0\nb,0,0\nb,1,1\n", "has 1 times of camera a, which has 2"),
        ("camera,sync_index,time\na,0,0\na,0,1\nb,0,0\nb,1,1\n", "instant 0 of camera a twice"),
        ("camera,frame,time\na,0,nan\n", "not a time"),
        *(
            (f"camera,frame,time\na,0,0\na,1,{time}\nb,0,0\nb,1,1\n", f"line 3: '{time}' is not a time")
            for time in ("1e300", "-1e300", "1e999999", "9e9")
        ),
    ],
)
def test_bad_tables_say_why(table: Callable[[str], Path], text: str, reason: str) -> None:
    with pytest.raises(BadInputError, match=reason):
        timeline_by_table([Numbers("a", range(2)), Numbers("b", range(2))], table(text))
