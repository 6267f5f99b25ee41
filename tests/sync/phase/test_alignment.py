"""When a stream is called aligned: its error and how sure that is, after how many frames and moves."""

from capture_app.camera_facts import PhaseControl
from capture_app.sync.phase.alignment import MOST_LANDINGS, Alignment

TOLERANCES_NS = 20_000, 20_000


def judged(alignment: Alignment, error_ns: float, doubt_ns: float = 2_000.0, frames: int = 10) -> bool:
    alignment.judge(error_ns, doubt_ns, frames, TOLERANCES_NS, 0.0)
    assert alignment.aligned is alignment.within_window
    return alignment.aligned


def test_an_injected_stream_is_aligned_within_half_its_tolerance_and_stays_so_within_all_of_it() -> None:
    alignment = Alignment(PhaseControl.INJECTION)
    assert not judged(alignment, 9_000.0), "it may be 11 us off"
    assert judged(alignment, 7_900.0)
    assert judged(alignment, -19_900.0)
    assert not judged(alignment, 20_100.0)
    assert not judged(alignment, 15_000.0), "once out, it must come near again"


def test_one_frame_is_not_enough() -> None:
    alignment = Alignment(PhaseControl.INJECTION)
    assert not judged(alignment, 0.0, frames=1)
    assert judged(alignment, 0.0, frames=2)


def test_more_frames_are_waited_for_only_while_they_may_tell() -> None:
    alignment = Alignment(PhaseControl.INJECTION)
    assert alignment.is_open(11_000.0, 5_000.0, 3, 20_000)
    assert not alignment.is_open(16_000.0, 5_000.0, 3, 20_000)
    assert not alignment.is_open(11_000.0, 5_000.0, 10, 20_000)


def test_where_no_move_comes_nearer_the_whole_tolerance_is_enough() -> None:
    alignment = Alignment(PhaseControl.INJECTION)
    assert not judged(alignment, 15_000.0)
    alignment.note_no_better()
    assert judged(alignment, 15_000.0)
    same = Alignment(PhaseControl.INJECTION)
    same.note_move(15_000.0)
    assert judged(same, 14_500.0), "the move led to the same place"
    other = Alignment(PhaseControl.INJECTION)
    other.note_move(-15_000.0)
    assert not judged(other, 14_500.0)


def test_a_stream_whose_moves_scatter_is_not_moved_for_ever() -> None:
    alignment = Alignment(PhaseControl.INJECTION)
    for sign in [1, -1] * (MOST_LANDINGS // 2):
        assert not judged(alignment, sign * 15_000.0)
        alignment.note_move(sign * 15_000.0)
    assert judged(alignment, 15_000.0)


def test_a_stream_that_lands_by_chance_is_not_restarted_for_noise() -> None:
    alignment = Alignment(PhaseControl.RESET)
    assert judged(alignment, 20_000.0, frames=1)
    assert judged(alignment, 21_500.0)
    assert not judged(alignment, 22_500.0)


def test_without_a_clock_nothing_is_aligned() -> None:
    alignment = Alignment(PhaseControl.FRAME_DURATION)
    assert judged(alignment, 15_000.0)
    alignment.clear()
    assert not alignment.aligned
    alignment.judge_unmoved(0.0, TOLERANCES_NS, 0.0)
    assert not alignment.aligned, "only a stream at rest may become aligned"
