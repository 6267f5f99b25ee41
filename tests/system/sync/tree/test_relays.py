"""Cameras below relays in virtual time: bursts, grids and names are the whole tree's, and relays may die."""

import pytest

from benchmarks.simulated.clock_tree import ROOT
from capture_app.common.node_state import NodeState
from capture_app.sync.rig.events import NodeChanged
from capture_app.sync.timekeeping.poll_schedule import ESTIMATE_EVERY_NS
from tests.unit.sync.rig.rigs import checked_error_ns
from tests.unit.sync.tree.relay_rig import RelayRig, S, camera_below_a_relay


def test_a_burst_reaches_cameras_below_relays_of_relays_in_the_roots_time() -> None:
    rig = RelayRig()
    upper = rig.relay("upper", ROOT)
    lower = rig.relay("lower", upper)
    rig.camera("near", ROOT)
    rig.camera("middle", upper)
    rig.camera("far", lower)
    rig.run_until(rig.all_ready)
    rig.check_burst()
    views = rig.views()
    assert {name: views[name].via for name in views} == {
        "near": None,
        "upper": None,
        "middle": "upper",
        "lower": "upper",
        "far": "lower",
    }
    # Reports are of different moments, and a bound grows by 1 ms a second between two of them.
    assert 0 < rig.hard_bound_now_ns("upper") < rig.hard_bound_now_ns("lower") < rig.hard_bound_now_ns("far")
    assert rig.tree.root.poll_interval_ns == 0


@pytest.mark.parametrize("next_parent", ["root", "relay"])
def test_the_clients_of_a_dead_relay_go_on_below_the_next_parent(next_parent: str) -> None:
    rig = RelayRig()
    dying, other = rig.relay("dying", ROOT), rig.relay("other", ROOT)
    below = rig.relay("below", dying, ROOT if next_parent == "root" else other)
    rig.camera("a", dying, ROOT if next_parent == "root" else other)
    rig.camera("b", below)
    rig.run_until(rig.all_ready)
    rig.check_burst()
    rig.kill("dying")
    rig.run(4.5)
    del rig.relays["dying"]
    rig.run_until(rig.all_ready)
    rig.check_burst()
    expected = None if next_parent == "root" else "other"
    assert (rig.views()["a"].via, rig.views()["below"].via) == (expected, expected)


def test_members_below_a_relay_are_ordered_and_answer_in_batches() -> None:
    rig = RelayRig()
    relay = rig.relay("relay", ROOT)
    for number in range(3):
        rig.camera(f"cam{number}", relay)
    rig.run_until(rig.all_ready)
    rig.run(5.0)
    before, sent = rig.heard_at_root.copy(), rig.sent_by_root.copy()
    rig.run(5.0)
    told = rig.heard_at_root - before
    assert 5 <= told["MemberReports"] <= 23, "however many they are"
    assert told["Heartbeat"] <= 13, "only the relay's own"
    assert (rig.sent_by_root - sent)["HeartbeatAck"] <= 13
    before, sent = rig.heard_at_root.copy(), rig.sent_by_root.copy()
    rig.check_burst()
    assert 1 <= (rig.sent_by_root - sent)["Trigger"] <= 3
    assert 1 <= (rig.heard_at_root - before)["TriggerAck"] <= 5


def test_a_camera_that_falls_silent_below_relays_is_lost_at_the_root() -> None:
    rig = RelayRig()
    lower = rig.relay("lower", rig.relay("upper", ROOT))
    for name in ("stays", "goes"):
        rig.camera(name, lower)
    rig.run_until(rig.all_ready)
    rig.kill("goes")
    rig.run(3.5)
    assert NodeChanged("goes", "lost", "silent for 2 s") in rig.events
    rig.run(4.0)
    assert rig.views()["goes"].lost
    assert not rig.views()["stays"].lost
    rig.kill("lower")
    rig.run(4.0)
    assert rig.views()["lower"].lost
    assert rig.views()["stays"].lost, "nobody speaks for it"


def test_a_relay_without_its_root_holds_the_time_over_even_for_new_clients() -> None:
    rig = RelayRig()
    relay = rig.relay("relay", ROOT)
    old = rig.camera("old", relay)
    rig.run_until(rig.all_ready)
    rig.kill("root")
    rig.run(5.0)
    assert rig.relays["relay"].member.time.number is None
    new = rig.camera("new", relay)
    # The longer the holdover, the coarser.
    rig.run_until(lambda: new.client.state in (NodeState.READY, NodeState.DEGRADED))
    for camera in (old, new):
        error_ns = checked_error_ns(camera.client.time_map, camera.clock, rig.tree.now_true_ns)
        assert abs(error_ns) < 1_000_000
    rig.tree.revive("root")
    rig.run_until(rig.all_ready)
    rig.run(ESTIMATE_EVERY_NS / S)
    rig.check_burst()


def test_clients_go_back_to_their_relay_once_it_is_there_again_but_not_before_a_burst() -> None:
    rig, camera = camera_below_a_relay(probe_every_ns=S)
    rig.kill("relay")
    rig.run_until(lambda: rig.views()["cam"].via is None)
    rig.relay("relay", ROOT)
    rig.run_until(rig.all_ready)
    rig.trigger(2, after_s=8)
    rig.run(7.0)
    assert rig.views()["cam"].via is None
    rig.run_until(lambda: rig.views()["cam"].via == "relay")
    assert len(camera.ready[-1].frames) == 2
    rig.check_burst()
    assert not any(
        isinstance(e, NodeChanged) and (e.name, e.change) == ("cam", "lost") for e in rig.events[-4:]
    )


def test_clients_leave_a_relay_that_has_lost_its_leader_for_one_that_has_not() -> None:
    rig = RelayRig(probe_every_ns=S)
    gate, other = rig.relay("gate", ROOT), rig.relay("other", ROOT)
    middle = rig.relay("middle", gate)
    relay = rig.relay("relay", middle)
    rig.run_until(rig.all_ready)
    rig.camera("cam", relay, other)
    stays = rig.camera("stays", relay)
    rig.run_until(rig.all_ready)
    assert rig.views()["cam"].via == "relay"
    rig.kill("gate")
    rig.run_until(lambda: rig.relays["relay"].leader.current.in_holdover)
    assert rig.relays["relay"].member.time.is_member, "its own parent is there, and alone"
    rig.run_until(lambda: rig.views()["cam"].via == "other")
    assert stays.client.state is NodeState.READY
    assert stays.client.leader_in_holdover
    assert "has lost the leader" in stays.client.report(0).message
