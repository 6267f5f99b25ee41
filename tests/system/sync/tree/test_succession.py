"""Ranked leaders in virtual time: killed, back again, split and healed; time and bursts go on."""

import random

import pytest

from capture_app.sync.rig.failover import MIN_ANSWERS
from capture_app.sync.rig.leader_engine import LeaderConfig
from capture_app.sync.tree.member import TreeMember
from capture_app.sync.tree.relay_engine import OF_CAMERAS, Relay
from tests.unit.sync.tree.test_succession import ready_rig

PROBED_S = MIN_ANSWERS + 2.0


@pytest.mark.parametrize("seed", [1, 0, 2])
def test_the_next_standby_leads_without_a_time_step_when_the_leader_is_lost(seed: int) -> None:
    rig = ready_rig(seed=seed)
    first, second = rig.machines["a"], rig.machines["b"]
    grid = first.leader.grid if first.leader is not None else None
    rig.kill("a")
    assert rig.until(lambda: rig.all_follow("b")) < 2.0
    continued = second.succession.continued
    assert continued is not None
    # The same time, as far as the one that goes on with it says; and the same instants.
    now_ns = rig.tree.now_true_ns
    local_ns = second.clock.local_from_true(now_ns)
    jump_ns = second.leader_ns(local_ns) - first.clock.local_from_true(now_ns)
    assert abs(jump_ns) <= continued.time_map.hard_bound_at(local_ns)
    assert abs(jump_ns) < 300_000
    assert second.leader is not None
    assert continued.grid == grid
    # These cameras cannot be moved: a leader follows what they drift.
    assert second.leader.grid is not None
    assert abs(continued.grid.phase_error(second.leader.grid.anchor_leader_ns)) < 300_000
    cameras = [camera.client for camera in rig.cameras.values()]
    ready_s = rig.until(lambda: any(client.state == "ready" for client in cameras))
    assert ready_s <= 0.1, "ten answers: the time that it knows goes on, and is accurate enough"
    assert rig.until(rig.all_ready) < 1.0
    rig.check_burst("b")


def test_a_returned_leader_follows_and_may_lead_again_without_a_time_step() -> None:
    rig = ready_rig(cameras=1)
    rig.kill("a")
    rig.until(lambda: rig.all_follow("b"))
    rig.until(rig.all_ready)
    rig.start("a")
    for _ in rig.steps(PROBED_S):
        # This one only follows.
        assert rig.all_follow("b")
        rig.check_time()
    assert rig.machines["a"].succession.leader == ("b", 0)
    rig.check_burst("b")
    rig.kill("b")
    assert rig.until(lambda: rig.all_follow("a")) < 2.0
    # The leader counts a camera as here once it has answered the welcome, some milliseconds later.
    rig.until(rig.all_ready)
    rig.check_burst("a")


def test_a_split_that_heals_leaves_the_leader_of_the_better_rank() -> None:
    rig = ready_rig()
    far = rig.cameras["cam1"]
    far_receives = far.receive_datagram
    rig.split("ab")
    far.receive_datagram = lambda data, address, now_ns: (
        None if address == ("a", 0) else far_receives(data, address, now_ns)
    )
    rig.until(lambda: rig.leading() == "ab" and rig.followed(far) == "b")
    for _ in rig.steps(PROBED_S):
        rig.check_time()
        assert [rig.followed(camera) for camera in rig.cameras.values()] == ["a", "b"]
    rig.split()
    far.receive_datagram = far_receives
    assert rig.until(lambda: rig.all_follow("a")) < 6.0
    rig.until(rig.all_ready)
    for _ in rig.steps(10.0):
        assert rig.all_follow("a")
    rig.check_burst("a")


@pytest.mark.parametrize("frozen_s", [3.0, 15.0])
def test_a_frozen_leader_that_wakes_does_not_take_the_cameras_back(frozen_s: float) -> None:
    rig = ready_rig()
    rig.freeze("a")
    for _ in rig.steps(frozen_s):
        pass
    assert {rig.followed(camera) for camera in rig.cameras.values()} == {"b"}
    rig.until(rig.all_ready)
    rig.tree.revive("a")
    for _ in rig.steps(PROBED_S):
        rig.check_time()
        assert {rig.followed(camera) for camera in rig.cameras.values()} == {"b"}
    assert rig.leading() == "b"
    assert rig.machines["a"].succession.leader == ("b", 0)
    rig.check_burst("b")


def test_of_three_each_waits_for_the_better_ones() -> None:
    rig = ready_rig("abc", cameras=1)
    rig.kill("a")
    assert rig.until(lambda: rig.all_follow("b")) < 2.0
    for _ in rig.steps(5.0):
        assert rig.leading() == "b"
    assert rig.machines["c"].succession.leader == ("b", 0)
    rig.kill("b")
    rig.until(lambda: rig.all_follow("c"), limit_s=6.0)
    rig.until(rig.all_ready)
    rig.check_burst("c")


def test_what_is_below_a_relay_keeps_the_time_as_well() -> None:
    rig = ready_rig(cameras=1)
    rng = random.Random("relay")
    parents = rig.addresses
    member = TreeMember("relay", 1, parents, rng, OF_CAMERAS)
    rig.tree.add("relay", Relay(member, LeaderConfig(0, 0), rng), rng, parents, member)
    below = rig.camera("below", (("relay", 0),))
    rig.until(lambda: below.client.state == "ready")
    for _ in rig.steps(10.0):
        pass
    rig.kill("a")
    rig.until(lambda: rig.all_follow("b") and member.leader == ("b", 0) and member.time.is_member)
    rig.cameras["below"] = below
    for _ in rig.steps(1.0):
        pass
    rig.check_burst("b")
    del rig.cameras["below"]
    for seconds in rig.steps(10.0):
        assert below.client.time_map is not None, seconds
        error_ns, local_ns = rig.error(below, "b")
        assert abs(error_ns) <= below.client.time_map.hard_bound_at(local_ns)
    rig.cameras["below"] = below
    rig.check_burst("b")


"""Longer than nodes, which probe each second here, probe a better leader before they go back to it."""


def test_a_standby_that_leads_beside_the_leader_takes_no_camera_and_no_burst() -> None:
    """Its program is changed: it leads from the first moment, whatever its rank and whoever leads."""
    rig = ready_rig()
    liar = rig.machines["b"].succession
    liar._look = lambda now_ns: setattr(liar, "leads", True)  # type: ignore[method-assign]
    for _ in rig.steps(PROBED_S):
        assert all(rig.followed(camera) == "a" for camera in rig.cameras.values())
        rig.check_time()
    assert rig.leading() == "ab"
    rig.check_burst("a")
