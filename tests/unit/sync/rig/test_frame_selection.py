"""Bursts: instants on the grid, and the frames picked for them."""

from typing import Any, cast

from hypothesis import given
from hypothesis import strategies as st

from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.rig.frame_selection import (
    NO_FRAME_OF_ITS_OWN,
    PAUSE_NS,
    CameraGrid,
    FrameSelection,
    Gap,
    RingBuffer,
    SelectedFrame,
    burst_instants,
)
from capture_app.sync.wire.datagrams import Trigger

PERIOD_NS = 33_333_333
HOUR_NS = 3_600_000_000_000
days = st.integers(-100 * HOUR_NS, 100 * HOUR_NS)


def time_map(offset_ns: int = 0, skew: float = 0.0, epoch_ns: int = 0) -> TimeMap:
    return TimeMap(epoch_ns, offset_ns, skew, 10_000.0, 50_000.0, 1e-6, 2e-6, 300, 1_000_000)


@given(days, days, st.floats(-1e-4, 1e-4), st.integers(-HOUR_NS, HOUR_NS))
def test_time_maps_invert(epoch: int, offset: int, skew: float, since: int) -> None:
    there = time_map(offset, skew, epoch)
    local_ns = epoch + since
    assert abs(there.local_from_leader(there.leader_from_local(local_ns)) - local_ns) <= 1


@given(
    anchor=st.integers(-HOUR_NS, HOUR_NS), period=st.integers(1, 10**9), leader=st.integers(-HOUR_NS, HOUR_NS)
)
def test_phase_error_is_within_half_a_period(anchor: int, period: int, leader: int) -> None:
    grid = FrameGrid(anchor, period)
    error_ns = grid.phase_error(leader)
    assert -period <= 2 * error_ns <= period
    assert (leader - error_ns - anchor) % period == 0


def test_a_burst_is_snapped_to_the_grid() -> None:
    grid = FrameGrid(1_000, PERIOD_NS)
    instants = burst_instants(grid, 1_000 + 10 * PERIOD_NS + 5_000_000, 3, 2)
    assert tuple(instants) == tuple(1_000 + n * PERIOD_NS for n in (10, 12, 14))


def ring_of(timestamps: list[int], span_ns: int = HOUR_NS) -> RingBuffer[int]:
    ring: RingBuffer[int] = RingBuffer(span_ns)
    for number, local_ns in enumerate(timestamps):
        ring.add(local_ns, number)
    return ring


def pick_frames(
    ring: RingBuffer[int], there: TimeMap, instants_ns: tuple[int, ...], period_ns: int
) -> tuple[list[SelectedFrame[int]], list[Gap]]:
    grid = CameraGrid(FrameGrid(0, period_ns))
    found = [grid.select(ring, there, n, at_ns) for n, at_ns in enumerate(instants_ns)]
    return [f for f in found if isinstance(f, SelectedFrame)], [f for f in found if isinstance(f, Gap)]


def test_the_nearest_frames_are_picked_with_their_error_bars() -> None:
    offset_ns = 5 * HOUR_NS
    there = time_map(offset_ns, 40e-6)
    instants = tuple(offset_ns + n * PERIOD_NS for n in (3, 4, 5))
    ring = ring_of([there.local_from_leader(offset_ns + n * PERIOD_NS + 20_000) for n in range(10)])
    picks, gaps = pick_frames(ring, there, instants, PERIOD_NS)
    assert [pick.frame for pick in picks] == [3, 4, 5]
    assert all(abs(pick.residual_ns - 20_000) <= 1 for pick in picks)
    assert all(pick.hard_bound_ns >= pick.uncertainty_ns > 0 for pick in picks)
    assert gaps == []


def test_a_dropped_frame_leaves_a_gap_and_shifts_nothing() -> None:
    ring = ring_of([n * PERIOD_NS for n in range(10) if n != 4])
    picks, gaps = pick_frames(ring, time_map(), tuple(n * PERIOD_NS for n in (3, 4, 5)), PERIOD_NS)
    assert [(pick.instant, pick.local_ns // PERIOD_NS) for pick in picks] == [(0, 3), (2, 5)]
    assert [(gap.instant, gap.reason) for gap in gaps] == [(1, "the camera dropped the frame")]


def test_a_camera_that_stood_still_for_long_has_not_dropped_its_frames() -> None:
    """As when it was plugged in again, or its node's process was stopped; nor has a move lengthened one."""
    ring = ring_of([n * PERIOD_NS for n in range(100) if not 20 <= n < 80])
    _, gaps = pick_frames(ring, time_map(), tuple(n * PERIOD_NS for n in (20, 34, 35, 64, 65, 79)), PERIOD_NS)
    short, still = "the camera dropped the frame", "the camera gave no frames"
    assert [gap.reason for gap in gaps] == [short, short, still, still, short, short]


def test_a_frame_in_the_middle_of_two_instants_belongs_to_the_first_of_them_alone() -> None:
    selection, grid = FrameSelection[int](), CameraGrid(FrameGrid(0, 1000))
    selection.add(Trigger(0, 1, 1, 0, 1000, 3))
    (found,) = selection.select_due(
        ring_of([0, 1500, 3000]), cast(Any, None), grid, time_map(), now_ns=3000, is_member=False
    )
    assert [(pick.instant, pick.frame) for pick in found.frames] == [(0, 0), (1, 1)]
    assert found.gaps == (Gap(2, NO_FRAME_OF_ITS_OWN),)


def test_a_later_trigger_of_a_recording_can_only_end_it_earlier() -> None:
    selection, spans_ns = FrameSelection[int](), []
    for count in (10, 4, 10):
        selection.add(Trigger(0, 1, 1, 0, 1000, count, streamed=True))
        spans_ns.append(selection.first_before(0))
    assert spans_ns == [(0, 9000), (0, 3000), (0, 3000)]


def test_between_the_frames_of_a_time_lapse_only_the_next_is_waited_for() -> None:
    ring, where = ring_of([0, PAUSE_NS]), (cast(Any, None), CameraGrid(FrameGrid(0, PAUSE_NS)), time_map())
    for step_ns, span_ns in ((PAUSE_NS, (2 * PAUSE_NS,) * 2), (PAUSE_NS - 1, (0, 9 * (PAUSE_NS - 1)))):
        selection = FrameSelection[int]()
        selection.add(Trigger(0, 1, 1, 0, step_ns, 10, streamed=True))
        selection.select_due(ring, *where, now_ns=PAUSE_NS, is_member=False, is_last=True)
        assert selection.first_before(4 * PAUSE_NS) == span_ns


def test_of_a_lost_leaders_bursts_only_recordings_with_an_ordered_end_go_on() -> None:
    selection, ring = FrameSelection[int](), ring_of([0, 1000])
    selection.add(Trigger(0, 1, 1, 0, 1000, 4))
    selection.add(Trigger(0, 1, 2, 0, 1000, 4, streamed=True))
    selection.add(Trigger(0, 1, 3, 0, 1000, 2**31, streamed=True))
    grid = CameraGrid(FrameGrid(0, 1000))
    selection.select_due(ring, cast(Any, None), grid, time_map(), now_ns=1100, is_member=False)
    (end,) = selection.keep_ordered()
    assert (end.trigger.burst, end.ended, end.over) == (3, True, end.trigger.count)
    assert [key in selection for key in ((1, 1), (1, 2), (1, 3))] == [False, True, False]
    (end,) = selection.keep_ordered(has_time=False)
    assert end.trigger.burst == 2
    assert not selection


def test_a_recording_ends_no_earlier_than_what_was_selected_when_its_end_came() -> None:
    """Its instants would never be over otherwise, and it would be pending for ever."""
    selection, grid = FrameSelection[int](), CameraGrid(FrameGrid(0, 1000))
    selection.add(Trigger(0, 1, 1, 0, 1000, 10, streamed=True))
    ring = ring_of([n * 1000 for n in range(6)])
    selected = list[int]()

    def select(now_ns: int) -> None:
        for found in selection.select_due(
            ring, cast(Any, None), grid, time_map(), now_ns=now_ns, is_member=False
        ):
            selected.extend(pick.instant for pick in found.frames)

    select(5000)
    selection.add(Trigger(0, 1, 1, 0, 1000, 2, streamed=True))
    select(20_000)
    assert len(selected) > 2
    assert not selection


def test_the_past_reaches_as_far_as_the_ring_buffer() -> None:
    ring = ring_of([n * PERIOD_NS for n in range(100)], span_ns=9 * PERIOD_NS)
    picks, gaps = pick_frames(ring, time_map(), (50 * PERIOD_NS, 95 * PERIOD_NS), PERIOD_NS)
    assert [pick.instant for pick in picks] == [1]
    assert [gap.reason for gap in gaps] == ["it had left the ring buffer"]


def test_what_a_machine_slept_through_is_reported_as_that() -> None:
    """Frames from before a sleep were taken for those of later instants, by the map from after it."""
    ring, there = ring_of([n * PERIOD_NS for n in range(10)]), time_map(5 * PERIOD_NS)
    ring.clear_after_sleep(10 * PERIOD_NS)
    before, after = tuple(n * PERIOD_NS for n in range(6, 15)), (17 * PERIOD_NS,)
    assert pick_frames(ring, there, before, PERIOD_NS)[1] == [Gap(n, "its machine slept") for n in range(9)]
    assert pick_frames(ring, there, after, PERIOD_NS)[1] == [Gap(0, "the camera gave no frames")]
    for late in (9, 12):
        ring.add(late * PERIOD_NS, late)
    picks, gaps = pick_frames(ring, there, (*before, *after), PERIOD_NS)
    assert [pick.frame for pick in picks] == [12], "what was taken before comes too late"
    assert gaps == [Gap(n, "its machine slept") for n in range(9)]


def test_frames_that_were_selected_before_a_sleep_keep_their_times() -> None:
    selection, grid = FrameSelection[int](), CameraGrid(FrameGrid(0, 1000))
    selection.add(Trigger(0, 1, 1, 0, 1000, 4))
    ring, where = ring_of([7, 1007, 2007]), (cast(Any, None), grid)
    assert not selection.select_due(ring, *where, time_map(), now_ns=2007, is_member=False, is_last=True)
    selection.keep_times()
    ring.clear_after_sleep(2100)
    ring.add(2508, 3)
    ring.add(3508, 4)
    (found,) = selection.select_due(ring, *where, time_map(500), now_ns=4000, is_member=False)
    assert [pick.residual_ns for pick in found.frames] == [7, 7, 7, 8]


def test_a_ring_buffer_takes_no_more_memory_than_it_may_but_has_the_newest_two_frames() -> None:
    ring = RingBuffer[str](max_bytes=100)
    for number in range(5):
        ring.add(number, "a frame", size_bytes=30)
    assert (len(ring), ring.oldest_local_ns) == (3, 2)
    ring.add(5, "a large frame", size_bytes=1000)
    assert (len(ring), ring.oldest_local_ns) == (2, 4)
    ring.clear_after_sleep(6)
    for number in range(6, 9):
        ring.add(number, "a frame", size_bytes=30)
    assert (len(ring), ring.oldest_local_ns) == (3, 6), "what was dropped counts no more"


def test_frames_from_before_a_clock_was_set_back_are_dropped() -> None:
    ring = ring_of([n * PERIOD_NS for n in range(100, 110)], span_ns=9 * PERIOD_NS)
    for number in range(3):
        ring.add(number * PERIOD_NS, number)
    assert (len(ring), ring.oldest_local_ns) == (3, 0)


def test_a_camera_without_frames_leaves_gaps() -> None:
    picks, gaps = pick_frames(RingBuffer[int](), time_map(), (0,), PERIOD_NS)
    assert picks == []
    assert [gap.reason for gap in gaps] == ["the camera gave no frames"]
