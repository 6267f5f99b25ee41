"""Bursts whose frames are told as they come, in virtual time: of any length, ended early, cut off."""

from dataclasses import replace

import pytest

from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from capture_app.common.clock import SimulatedClock
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.sync.rig.events import FramesDropped, PhaseMoved
from capture_app.sync.rig.frame_selection import DROPPED, MAX_STREAMED_NS, MOVED, SLEPT, Burst, FramesSelected
from capture_app.sync.timekeeping.clock_events import TimesDoubted
from tests.unit.sync.rig.rigs import LAN, MS, S, ready_rig

FRAMES = 300
"""Five times what the ring buffer holds."""


def rig_of_two(drop_fraction: float = 0.0) -> VirtualRig:
    profile = replace(PROFILES["perfect"], drop_fraction=drop_fraction)
    return ready_rig([NodeSpec(f"cam{n}", profile, SimulatedClock(n * S), LAN) for n in range(2)], seed=3)


def ended(rig: VirtualRig, number: int) -> bool:
    return all(number in node.bursts and node.bursts[number].ended for node in rig.nodes.values())


def test_every_frame_of_a_long_burst_is_reported_as_it_arrives() -> None:
    rig = rig_of_two()
    burst = rig.trigger(frames=FRAMES, streamed=True)
    assert rig.run_until(lambda: rig.now_true_ns > burst.instants_ns[100], limit_ns=10 * S)
    for node in rig.nodes.values():
        assert 99 <= node.bursts[burst.number].over <= 101
        assert not node.bursts[burst.number].ended
    assert rig.run_until(lambda: ended(rig, burst.number), limit_ns=20 * S)
    for node in rig.nodes.values():
        picked = node.bursts[burst.number]
        assert [pick.instant for pick in picked.frames] == [*range(FRAMES)]
        assert all(abs(p.frame.start_true_ns - burst.instants_ns[p.instant]) < 150_000 for p in picked.frames)
        events = [event for event in node.events if isinstance(event, FramesSelected)]
        assert max(len(event.frames) for event in events) <= 2
        assert len(node.client.ring) <= 61


def recording_of_drifters(*, moves: bool) -> tuple[VirtualRig, Burst]:
    """Record 12 s with two cameras that drift by some 100 us a second against each other."""
    profile = replace(PROFILES["perfect"], period_error_ppm=80.0)
    rig = ready_rig([NodeSpec(f"cam{n}", profile, SimulatedClock(n * S), LAN) for n in range(2)], seed=3)
    for node in rig.nodes.values():
        node.client.config = replace(node.client.config, moves_in_recordings=moves)
    burst = rig.trigger(frames=360, streamed=True)
    assert rig.run_until(lambda: ended(rig, burst.number), limit_ns=20 * S)
    return rig, burst


def test_drift_within_a_recording_is_taken_back_by_single_frames() -> None:
    rig, burst = recording_of_drifters(moves=True)
    moved: set[int] = set()
    errors_ns: dict[int, list[int]] = {}
    for node in rig.nodes.values():
        picked = node.bursts[burst.number]
        moves = [event for event in node.events if isinstance(event, PhaseMoved)]
        assert 1 <= len(moves) <= 12
        for move in moves:
            at_ns = node.spec.clock.true_from_local(move.local_ns)
            last = round((at_ns - burst.instants_ns[0]) / burst.step_ns)
            moved |= {*range(last - 3, last + 1)}
        assert {gap.reason for gap in picked.gaps} <= {MOVED}
        assert {gap.instant for gap in picked.gaps} <= moved
        for pick in picked.frames:
            error_ns = pick.frame.start_true_ns - burst.instants_ns[pick.instant]
            errors_ns.setdefault(pick.instant, []).append(error_ns)
            assert abs(pick.residual_ns - error_ns) < 100_000, "a moved frame's time is known, too"
    whole = {instant: of for instant, of in errors_ns.items() if len(of) == 2 and instant not in moved}
    assert len(whole) > 300
    assert max(abs(a - b) for a, b in whole.values()) < 300_000


def test_a_camera_may_be_let_drift() -> None:
    rig, burst = recording_of_drifters(moves=False)
    ends_ns = []
    for node in rig.nodes.values():
        picked = node.bursts[burst.number]
        moves = [event.local_ns for event in node.events if isinstance(event, PhaseMoved)]
        assert all(node.spec.clock.true_from_local(ns) < burst.instants_ns[0] for ns in moves)
        assert not picked.gaps
        ends_ns.append(picked.frames[-1].frame.start_true_ns)
    assert abs(ends_ns[0] - ends_ns[1]) > 400_000


def test_the_last_frame_of_a_camera_that_fails_is_selected_at_once() -> None:
    """It waited 30 periods for one that might be nearer, and was lost with its node meanwhile."""
    rig = rig_of_two()
    burst = rig.trigger(frames=FRAMES, streamed=True)
    node = rig.nodes["cam0"]
    assert rig.run_until(
        lambda: (node.client.ring.newest_local_ns or 0) > burst.instants_ns[50] - 5 * MS, limit_ns=10 * S
    )
    assert node.bursts[burst.number].over == 50, "a later frame might be nearer"
    node.client.fail("the camera went away")
    node.client.handle_timer(rig.now_true_ns)
    events = iter(node.client.next_event, None)
    (selected,) = (event for event in events if isinstance(event, FramesSelected))
    assert [frame.instant for frame in selected.frames] == [50]


def test_dropped_frames_are_reported_with_the_rest() -> None:
    rig = rig_of_two(drop_fraction=0.05)
    burst = rig.trigger(frames=FRAMES, streamed=True)
    assert rig.run_until(lambda: ended(rig, burst.number), limit_ns=20 * S)
    for node in rig.nodes.values():
        picked = node.bursts[burst.number]
        instants = sorted([p.instant for p in picked.frames] + [gap.instant for gap in picked.gaps])
        assert instants == [*range(FRAMES)]
        assert picked.gaps
        assert {gap.reason for gap in picked.gaps} == {DROPPED}
        assert picked.over == FRAMES
        drops = sum(event.count for event in node.events if isinstance(event, FramesDropped))
        assert drops == node.client.aligner.phase.drops >= len(picked.gaps)


def test_a_long_burst_can_be_ended_early() -> None:
    rig = rig_of_two()
    burst = rig.trigger(frames=10_000_000, streamed=True)
    assert rig.run_until(lambda: rig.now_true_ns > burst.instants_ns[50], limit_ns=10 * S)
    assert rig.end(burst, 70).frames == 70
    assert rig.run_until(lambda: ended(rig, burst.number), limit_ns=10 * S)
    for node in rig.nodes.values():
        assert [pick.instant for pick in node.bursts[burst.number].frames] == [*range(70)]
        assert not node.client.has_burst_pending


def test_a_burst_without_an_ordered_end_ends_with_its_leader() -> None:
    rig = rig_of_two()
    assert rig.leader.grid is not None
    burst = rig.trigger(frames=MAX_STREAMED_NS // rig.leader.grid.period_ns, streamed=True)
    # A node notices within one request, mostly before a frame just taken has arrived.
    assert rig.run_until(lambda: rig.now_true_ns > burst.instants_ns[52], limit_ns=10 * S)
    rig.restart_leader()
    assert rig.run_until(lambda: ended(rig, burst.number), limit_ns=60 * S)
    for node in rig.nodes.values():
        picked = node.bursts[burst.number]
        assert picked.over == len(picked.frames) >= 50
        assert abs(picked.frames[0].residual_ns) < 100_000, "it begins on the grid, though its end is open"


def test_a_machine_that_slept_knows_no_time_until_it_has_asked_again() -> None:
    rig = rig_of_two()
    burst = rig.trigger(frames=300, streamed=True)
    assert rig.run_until(lambda: rig.now_true_ns > burst.instants_ns[52] - 5 * MS, limit_ns=10 * S)
    client, now_ns = rig.nodes["cam1"].client, rig.nodes["cam1"].spec.clock.local_from_true(rig.now_true_ns)
    client.wake_up(12 * S, now_ns)
    events = [*iter(client.next_event, None)]
    assert [pick.instant for event in events[:1] for pick in event.frames] == [51], "no nearer one comes"
    (doubted,) = (event for event in events if isinstance(event, TimesDoubted))
    assert (doubted.from_local_ns, doubted.until_local_ns) == (now_ns, now_ns)
    assert doubted.error_ns > 12 * S
    assert (client.why_joining, client.time_map) == ("its machine slept for 12.0 s", None)
    assert rig.run_until(lambda: ended(rig, burst.number), limit_ns=20 * S)
    assert (
        rig.nodes["cam1"].client.timekeeper.clock.samples < rig.nodes["cam0"].client.timekeeper.clock.samples
    )
    assert not rig.nodes["cam1"].bursts[burst.number].gaps


def test_no_frame_from_before_a_sleep_is_selected_for_a_later_order() -> None:
    """Its time is by a clock that stood still since."""
    rig = rig_of_two()
    rig.run_for(S)
    node, before_ns = rig.nodes["cam1"], rig.now_true_ns
    node.client.wake_up(12 * S, node.spec.clock.local_from_true(before_ns))
    assert rig.run_until(rig.all_ready, limit_ns=20 * S)
    burst = rig.trigger(frames=5, at_leader_ns=before_ns - S // 2)
    assert rig.run_until(lambda: burst.number in node.bursts, limit_ns=5 * S)
    assert {gap.reason for gap in node.bursts[burst.number].gaps} == {SLEPT}
    assert not node.bursts[burst.number].frames


def test_frames_from_before_a_sleep_in_which_the_clock_ran_on_keep_their_times() -> None:
    rig = rig_of_two()
    burst = rig.trigger(frames=60)
    assert rig.run_until(lambda: rig.now_true_ns > burst.instants_ns[20], limit_ns=10 * S)
    node = rig.nodes["cam1"]
    node.spec = replace(node.spec, clock=SimulatedClock(node.spec.clock.local_from_true(0) + 12 * S))
    node.client.wake_up(12 * S, node.spec.clock.local_from_true(rig.now_true_ns))
    assert rig.run_until(lambda: burst.number in node.bursts, limit_ns=20 * S)
    picked = node.bursts[burst.number].frames
    assert [pick.instant for pick in picked[:19]] == [*range(19)]
    assert all(abs(pick.residual_ns) < 100_000 for pick in picked)


@pytest.mark.parametrize("is_before", [True, False])
def test_a_burst_of_a_lost_leader_ends_with_a_sleep_as_its_time_is_lost(*, is_before: bool) -> None:
    """It was selected by the time from before, or never ended, so that its last image stayed on its node."""
    rig = rig_of_two()
    burst = rig.trigger(frames=300, streamed=True)
    assert rig.run_until(lambda: rig.now_true_ns > burst.instants_ns[52], limit_ns=10 * S)
    rig.suspend_leader()
    rig.run_for(2 * S)
    node = rig.nodes["cam1"]
    if is_before:
        node.client.wake_up(12 * S, node.spec.clock.local_from_true(rig.now_true_ns))
    rig.wake_leader()
    rig.restart_leader()
    assert rig.run_until(lambda: node.client.is_member, limit_ns=60 * S)
    if not is_before:
        assert node.client.has_burst_pending
        node.client.wake_up(12 * S, node.spec.clock.local_from_true(rig.now_true_ns))
    rig.run_for(S)
    assert not node.client.has_burst_pending
    assert node.bursts[burst.number].over < 300
    assert node.bursts[burst.number].ended


@pytest.mark.parametrize("lost_s", [0, 2])
def test_a_burst_with_an_ordered_end_goes_on_when_its_leader_is_started_again(lost_s: int) -> None:
    """By the next run's time, or in holdover where that is another: its clock has lost some seconds."""
    rig = rig_of_two()
    burst = rig.trigger(frames=300, streamed=True)
    assert rig.run_until(lambda: rig.now_true_ns > burst.instants_ns[52], limit_ns=10 * S)
    rig.suspend_leader()
    rig.run_for(lost_s * S)
    rig.wake_leader()
    rig.restart_leader()
    assert rig.run_until(lambda: rig.now_true_ns > burst.instants_ns[-1] + S, limit_ns=60 * S)
    for node in rig.nodes.values():
        assert node.client.is_member
        frames = node.bursts[burst.number].frames
        assert [pick.instant for pick in frames] == [*range(300)]
        late_ns = [pick.frame.start_true_ns - burst.instants_ns[pick.instant] for pick in frames]
        assert max(map(abs, late_ns)) < 1_000_000
        assert max(abs(pick.residual_ns) for pick in frames) < 1_000_000
        assert not node.client.has_burst_pending


def test_a_camera_that_is_started_again_continues_a_burst_once_it_is_aligned() -> None:
    rig = rig_of_two()
    burst = rig.trigger(frames=600, streamed=True)
    assert rig.run_until(lambda: rig.now_true_ns > burst.instants_ns[52], limit_ns=10 * S)
    spec = rig.nodes["cam1"].spec
    rig.kill("cam1")
    rig.run_for(3 * S)
    node = rig.start(spec)
    assert rig.run_until(lambda: ended(rig, burst.number), limit_ns=60 * S)
    picked = node.bursts[burst.number]
    frames = [pick.instant for pick in picked.frames]
    assert frames[-1] == 599
    assert {gap.instant for gap in picked.gaps} == {*range(600)} - {*frames}
    assert len(frames) > 250
    assert max(abs(pick.residual_ns) for pick in picked.frames[100:]) < 200_000
    assert not node.client.has_burst_pending


def test_webcams_that_are_all_started_again_continue_a_burst() -> None:
    """They waited for a restart that suits all until the burst was over, as the grid stays meanwhile."""
    profile = replace(PROFILES["webcam"], drop_fraction=0.0, outlier_fraction=0.0)
    specs = [NodeSpec(f"cam{n}", profile, SimulatedClock(n * S), LAN, tolerance_ns=2 * MS) for n in range(2)]
    rig = ready_rig(specs, seed=3)
    burst = rig.trigger(frames=600, streamed=True)
    grid = rig.leader.grid
    assert rig.run_until(lambda: rig.now_true_ns > burst.instants_ns[52], limit_ns=10 * S)
    for spec in specs:
        rig.kill(spec.name)
    rig.run_for(3 * S)
    nodes = [rig.start(spec) for spec in specs]
    assert rig.run_until(lambda: ended(rig, burst.number), limit_ns=60 * S)
    assert rig.leader.grid == grid
    for picked in (node.bursts[burst.number] for node in nodes):
        assert picked.frames[-1].instant == 599
        assert len(picked.frames) > 250
        assert max(abs(pick.residual_ns) for pick in picked.frames[100:]) < 2.2 * MS
