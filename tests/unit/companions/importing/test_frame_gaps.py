"""Imports report frames that a camera dropped or doubled, by the recording's own times."""

from pathlib import Path

import pytest

from capture_app.common.errors import BadInputError
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.importing.frame_matching import (
    TimedFrame,
    check_order,
    describe_times,
    find_extra_steps,
)
from tests.imported import import_one
from tests.unit.companions.importing.numbered_video import write_video

PERIOD_US = 16_667
REGULAR_US = [number * PERIOD_US for number in range(11)]
DROPPED = (
    "1 frame is missing after frame 4 (0.07 s), where 33.3 ms pass instead of 16.7"
)  # fmt: skip


@pytest.mark.parametrize(
    ("steps", "extra"),
    [
        ([10, 10, 20, 10], {2: 1}),
        ([10, 41, 10, 10], {1: 3}),
        ([10, 20, 20, 10], {1: 1, 2: 1}),
        ([10, 2, 10, 10], {1: -1}),
        # Late and early frames.
        ([10, 17, 3, 10], {}),
        ([10, 4, 16, 10], {}),
        # A late frame after a gap: one frame is missing, not two.
        ([10, 27, 3, 10], {2: 1}),
        ([20, 10, 10, 20], {0: 1, 3: 1}),
        ([10, 10, 10], {}),
    ],
)
def test_missing_and_doubled_frames_are_told_from_late_ones(steps: list[int], extra: dict[int, int]) -> None:
    assert find_extra_steps(steps, 10) == extra


def test_gaps_are_counted_and_the_first_is_placed() -> None:
    times_ns = [at_us * 1000 for at_us in REGULAR_US]
    assert describe_times(times_ns) == ""
    assert describe_times([at_ns for number, at_ns in enumerate(times_ns) if number != 5]) == DROPPED
    gone = [at_ns for number, at_ns in enumerate(times_ns) if number not in (3, 8)]
    assert describe_times(gone).startswith(
        "2 frames are missing in 2 places, the first after frame 2 (0.03 s)"
    )
    twice = sorted([*times_ns, times_ns[6] + 500_000])
    assert (
        describe_times(twice)
        == "1 frame is doubled after frame 6 (0.10 s), where 0.5 ms pass instead of 16.7"
    )


def test_recordings_without_a_rate_have_no_gaps() -> None:
    irregular = [0, 10, 45, 50, 80, 130, 135, 190]
    assert describe_times([at_ms * 1_000_000 for at_ms in irregular]) == ""
    assert describe_times([0, 10, 30]) == ""


@pytest.mark.parametrize("synchronized", [False, True])
def test_import_reports_a_dropped_frame(tmp_path: Path, synchronized: bool) -> None:
    left = write_video(tmp_path / "left.mp4", REGULAR_US)
    right = write_video(tmp_path / "right.mp4", [at for number, at in enumerate(REGULAR_US) if number != 5])
    said: list[str] = []
    options = ImportOptions(synchronized=synchronized, align="none")
    import_one([f"left={left}", f"right={right}"], tmp_path, "s", options, talk=said.append)
    (line,) = (one for one in said if "missing" in one)
    assert line.startswith(f"right: {DROPPED}")
    # Numbers do not know that frame 5 is gone, times do.
    assert line.endswith("take --times video") == synchronized


def test_two_frames_of_one_time_are_out_of_order() -> None:
    frames = [TimedFrame(number, at_ns) for number, at_ns in enumerate((0, 5, 5))]
    check_order("left.csv", frames[:2])
    with pytest.raises(BadInputError, match="frame 2 is at the same time as frame 1"):
        check_order("left.csv", frames)
