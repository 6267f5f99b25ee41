"""Which of the commanded shifts a frame has felt."""

from capture_app.sync.phase.estimator import LATENCY_FRAMES, PendingShifts

ROW = 20_000


def test_each_frame_tells_by_its_time_which_shifts_it_felt() -> None:
    shifts = PendingShifts()
    shifts.expect(100, ROW)
    assert shifts.effective_at(101, 19_000.0) == 0, "no device is so quick"
    assert shifts.effective_at(103, 1_000.0) == 0
    assert shifts.effective_at(104, 17_000.0) == ROW
    assert shifts.effective_at(105, 3_000.0) == 0, "each frame by itself"
    assert shifts.total_ns == ROW
    latest = 100 + LATENCY_FRAMES[1]
    assert shifts.certain_at(latest) == ROW
    assert shifts.effective_at(latest, 0.0) == ROW, "by now it counts"


def test_shifts_count_in_their_order() -> None:
    shifts = PendingShifts()
    shifts.expect(100, 3 * ROW)
    shifts.expect(101, -ROW)
    assert shifts.effective_at(104, 2.9 * ROW) == 3 * ROW
    assert shifts.effective_at(105, 2.1 * ROW) == 2 * ROW


def test_what_a_frame_felt_is_remembered() -> None:
    shifts = PendingShifts()
    for index in range(60):
        if index in (10, 30):
            shifts.expect(index, ROW)
        shifts.effective_at(index, (index >= 14) * ROW + (index >= 34) * ROW)
    assert [shifts.seen_at(index) for index in (0, 13, 14, 33, 34, 59)] == [0, 0, ROW, ROW, 2 * ROW, 2 * ROW]
    shifts.clear()
    assert shifts.seen_at(20) == 0
