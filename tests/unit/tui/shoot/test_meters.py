"""Numbers about what a camera sees, and which two pictures are blinked."""

from capture_app.protocol.status import Preview
from capture_app.tui.shoot.full_view import nearest_pair
from capture_app.tui.shoot.preview_grid import grid_columns
from capture_app.tui.widgets.focus_aids import (
    Exposure,
    exposure_line,
    focus_line,
    histogram_lines,
)


def test_focus_is_held_against_its_best_of_late() -> None:
    assert "no picture yet" in focus_line([]).plain
    numbers = [(0.0, 0.5), (1.0, 2.0), (2.0, 1.0)]
    assert "1.000  ████████████░░░░░░░░░░░░  50% of the best in 10 s" in focus_line(numbers).plain
    forgotten = focus_line([*numbers, (11.5, 1.0)]).plain
    assert "100% of the best" in forgotten, "the best is forgotten after ten seconds"


def test_clipping_is_told_where_it_is_worth_it() -> None:
    dark = Exposure(histogram=(1.0,), mean=25.5, shadows=0.02, highlights=0.0)
    assert exposure_line(dark).plain == "light     10.0%  ▼ clipped black 2.0%    clipped white 0.0%"


def test_the_histogram_shows_all_that_is_there() -> None:
    histogram = (0.5, 0.0, 0.001, 0.499)
    lines = [line.plain for line in histogram_lines(Exposure(histogram, 128, 0, 0), 4, 2)]
    assert lines == ["█  █", "█ ▁█"]
    assert [len(line.plain) for line in histogram_lines(Exposure(histogram, 128, 0, 0), 10, 3)] == [10] * 3


def preview(camera: str, leader_ns: int | None) -> Preview:
    return Preview(camera=camera, leader_ns=leader_ns, width=1, height=1, jpeg=b"")


def test_the_pair_is_the_nearest_in_time_and_the_newest_of_equals() -> None:
    first = [preview("a", leader_ns) for leader_ns in (0, 100, None, 200)]
    second = [preview("b", leader_ns) for leader_ns in (30, 104, None, 204)]
    assert nearest_pair(first, []) is None
    pair = nearest_pair(first, second)
    assert pair is not None
    assert (pair[0], pair[1].leader_ns, pair[2].leader_ns) == (4, 200, 204)


def test_pictures_are_laid_out_as_large_as_they_can_be() -> None:
    assert grid_columns(1, 80, 24) == 1
    assert grid_columns(2, 80, 24) == 2
    assert grid_columns(5, 150, 44) == 3
    assert grid_columns(20, 200, 50) == 5
    assert grid_columns(3, 30, 60) == 1
