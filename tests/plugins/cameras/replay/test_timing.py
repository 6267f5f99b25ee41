"""When a recording's frames are played: its own times, over and over, in streams that can be moved."""

from itertools import pairwise

from capture_app.plugins.cameras.replay.recordings import Playback, RecordedTiming, timing_of_video

PERIOD = 1000
JITTERY = timing_of_video((50, 1057, 2043, 5050), PERIOD)
"""Two frames were dropped before the last."""


def play(playback: Playback, count: int) -> list[tuple[int, int, int, int]]:
    """The next frames: index, sequence, stream and start of each."""
    return [playback.next_frame() for _ in range(count)]


def test_jitter_and_drops_are_the_recordings_own_and_come_again() -> None:
    playback = Playback(JITTERY)
    playback.start(70_000)
    indices, sequences, _, starts_ns = zip(*play(playback, 9), strict=True)
    assert indices == (0, 1, 2, 3, 0, 1, 2, 3, 0)
    assert sequences == (0, 1, 2, 5, 6, 7, 8, 11, 12)
    steps = [after_ns - before_ns for before_ns, after_ns in pairwise(starts_ns)]
    assert starts_ns[0] == 70_000
    assert steps == [1007, 986, 3007, PERIOD, 1007, 986, 3007, PERIOD]


def test_a_restarted_stream_goes_on_where_it_was_at_the_time_asked_for() -> None:
    playback = Playback(JITTERY)
    playback.start(0)
    play(playback, 2)
    playback.start(9_999)
    assert play(playback, 2) == [(2, 0, 1, 9_999), (3, 3, 1, 9_999 + 3007)]


def test_a_longer_frame_moves_all_that_come_after_it() -> None:
    playback = Playback(JITTERY)
    playback.start(0)
    play(playback, 1)
    playback.lengthen_frame(PERIOD + 250)
    assert [start_ns for *_, start_ns in play(playback, 2)] == [1257, 2243]


def test_anchored_cameras_keep_their_distance_whenever_they_start() -> None:
    one = RecordedTiming(PERIOD, 4 * PERIOD, (0, 1000, 2000, 3000))
    late = RecordedTiming(PERIOD, 4 * PERIOD, (120, 1120, 3120))
    first, second = Playback(one, anchored=True), Playback(late, anchored=True)
    first.start(17 * PERIOD + 1)
    second.start(933 * PERIOD)
    frames = {start_ns: index for index, _, _, start_ns in play(first, 4000)}
    for index, _, _, start_ns in play(second, 30):
        assert frames[start_ns - 120] == (0, 1, 3)[index]
    third = Playback(one, anchored=True)
    third.start(17 * PERIOD)
    assert play(third, 1) == [(1, 0, 0, 17 * PERIOD)]
