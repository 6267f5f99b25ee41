"""When a stream is called aligned: its error, how sure that is, and after how many frames."""

from capture_app.common.camera_facts import PhaseControl
from capture_app.sync.phase.aligner import AlignmentWindow
from capture_app.sync.phase.estimator import PhaseEstimate

TOLERANCE_NS = 20_000


def estimate(error_ns: int, doubt_ns: float = 2_000.0, frames: int = 10) -> PhaseEstimate:
    return PhaseEstimate(error_ns, 33_333_333, 0.0, doubt_ns / 2.0, frames, 0)


def judged(window: AlignmentWindow, error_ns: int) -> bool:
    window.judge(estimate(error_ns))
    assert window.aligned is window.within_window
    return window.aligned


def test_a_stream_that_was_not_moved_is_aligned_within_half_its_tolerance_and_stays_so_within_all() -> None:
    window = AlignmentWindow(TOLERANCE_NS, PhaseControl.INJECTION)
    assert not judged(window, 9_000), "it may be 11 us off"
    assert judged(window, 7_900)
    assert judged(window, -19_900)
    assert not judged(window, 20_100)
    assert not judged(window, 15_000), "once out, it must come near again"


def test_for_one_that_was_moved_all_of_its_tolerance_is_enough() -> None:
    window = AlignmentWindow(TOLERANCE_NS, PhaseControl.INJECTION)
    window.landing_fraction = 1.0
    assert not judged(window, 19_000), "it may be 21 us off"
    assert judged(window, 17_900)
    assert not judged(window, 20_100)


def test_more_frames_are_awaited_only_while_they_can_decide() -> None:
    window = AlignmentWindow(TOLERANCE_NS, PhaseControl.INJECTION)
    assert window.is_open(estimate(11_000, 5_000.0, 3))
    assert not window.is_open(estimate(16_000, 5_000.0, 3))
    assert not window.is_open(estimate(11_000, 5_000.0, 10))


def test_a_stream_that_lands_by_chance_is_not_restarted_for_noise() -> None:
    window = AlignmentWindow(TOLERANCE_NS, PhaseControl.RESET)
    assert judged(window, 20_000)
    assert judged(window, 21_900)
    assert not judged(window, 22_100)


def test_without_a_clock_nothing_is_aligned() -> None:
    window = AlignmentWindow(TOLERANCE_NS, PhaseControl.FRAME_DURATION)
    assert judged(window, 15_000)
    window.clear()
    assert not window.aligned
    window.judge_unmoved(0)
    assert not window.aligned, "only a stream at rest may become aligned"
