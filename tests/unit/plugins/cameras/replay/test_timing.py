"""When a recording's frames are played: its own times, over and over, in streams that can be moved."""

from itertools import pairwise

import pytest

from capture_app.plugins.cameras.replay.recordings import Playback, RecordedTiming, timing_of_video

PERIOD = 1000
JITTERY = timing_of_video((50, 1057, 2043, 5050), PERIOD)
"""Two frames were dropped before the last."""


def play(playback: Playback, count: int) -> list[tuple[int, int, int, int]]:
    """The next frames: index, sequence, stream and start of each."""
    return [playback.next_frame() for _ in range(count)]


def test_jitter_and_drops_are_the_recordings_own_and_come_again() -> None:
    playback = Playback(JITTERY)
    playback.start(65_900)
    indices, sequences, _, starts_ns = zip(*play(playback, 9), strict=True)
    assert indices == (0, 1, 2, 3, 0, 1, 2, 3, 0)
    assert sequences == (0, 1, 2, 5, 6, 7, 8, 11, 12)
    steps = [after_ns - before_ns for before_ns, after_ns in pairwise(starts_ns)]
    assert starts_ns[0] == 11 * JITTERY.loop_ns
    assert steps == [1007, 986, 3007, PERIOD, 1007, 986, 3007, PERIOD]


def test_a_restarted_stream_begins_with_the_frame_nearest_to_the_time_asked_for() -> None:
    playback = Playback(JITTERY, restarts=True)
    playback.start(0)
    play(playback, 2)
    playback.start(8_100)  # 2,100 after the loop's beginning, and 107 after the third frame
    assert play(playback, 2) == [(2, 0, 1, 8_100), (3, 3, 1, 8_100 + 3007)]


@pytest.mark.parametrize("restarts", [False, True])
def test_cameras_of_one_recording_show_the_same_frame_wherever_the_rig_aligns_them(restarts: bool) -> None:
    """The rig's instants lie 300 after the recording's frames; the cameras began 7 and 23 loops ago."""
    timing = RecordedTiming(PERIOD, 7 * PERIOD, tuple(range(0, 7 * PERIOD, PERIOD)))
    shown = []
    for begun_ns in (7 * timing.loop_ns + 870, 23 * timing.loop_ns + 5210):
        playback = Playback(timing, restarts=restarts)
        playback.start(begun_ns)
        if restarts:
            playback.start(50 * timing.loop_ns + 300 + begun_ns % 3)
        else:
            playback.lengthen_frame(PERIOD + 300)
        frames = {round(start_ns, -1): index for index, _, _, start_ns in play(playback, 500)}
        shown.append([frames[60 * timing.loop_ns + 300 + step * PERIOD] for step in range(7)])
    assert shown[0] == shown[1] == [*range(7)]


def test_a_longer_frame_moves_all_that_come_after_it() -> None:
    playback = Playback(JITTERY)
    playback.start(0)
    play(playback, 1)
    playback.lengthen_frame(PERIOD + 250)
    assert [start_ns for *_, start_ns in play(playback, 2)] == [1257, 2243]


def test_cameras_that_cannot_be_moved_keep_their_distance_whenever_they_start() -> None:
    one = RecordedTiming(PERIOD, 4 * PERIOD, (0, 1000, 2000, 3000))
    late = RecordedTiming(PERIOD, 4 * PERIOD, (120, 1120, 3120))
    first, second = Playback(one), Playback(late)
    first.start(17 * PERIOD + 1)
    second.start(933 * PERIOD)
    frames = {start_ns: index for index, _, _, start_ns in play(first, 4000)}
    for index, _, _, start_ns in play(second, 30):
        assert frames[start_ns - 120] == (0, 1, 3)[index]
    third = Playback(one)
    third.start(17 * PERIOD)
    assert play(third, 1) == [(1, 0, 0, 17 * PERIOD)]
