"""Cameras below relays in virtual time: bursts, grids and names are the whole tree's, and relays may die."""

import random

from msgspec import structs

from benchmarks.simulated.clock_tree import ROOT
from capture_app.common.node_state import NodeState
from capture_app.sync.rig.client import Client, ClientConfig
from capture_app.sync.rig.events import LeaderNotice, NodeChanged, TriggerAnswered
from capture_app.sync.rig.rig_config import RequestedConfig
from capture_app.sync.wire.codec import decode
from capture_app.sync.wire.datagrams import Hello
from tests.unit.sync.tree.relay_rig import CAMERA, Camera, RelayRig, S, camera_below_a_relay


def test_a_camera_that_can_only_restart_is_weighed_by_the_root_wherever_it_is() -> None:
    rig = RelayRig()
    relay = rig.relay("relay", ROOT)
    rig.camera("near", ROOT)
    far = rig.camera("far", relay, control="reset")
    grid = rig.tree.root.grid
    rig.run_until(lambda: rig.all_ready() and rig.tree.root.grid != grid)
    assert rig.tree.root.grid == rig.relays["relay"].leader.grid
    assert far.client.aligner.window.aligned


def test_two_cameras_of_one_name_are_distinguished_anywhere_in_the_tree() -> None:
    rig = RelayRig()
    one, two = rig.relay("one", ROOT), rig.relay("two", ROOT)
    first = rig.camera("cam", one, at="cam")
    rig.run_until(lambda: first.client.state is NodeState.READY)
    second = rig.camera("cam", two, at="other")
    rig.run(4.0)
    assert first.client.is_member
    (said,) = (event for event in first.events if isinstance(event, LeaderNotice) and event.what == "said")
    assert "another camera below two wants to be cam" in said.text
    assert second.client.state is NodeState.JOINING
    refusal = "another camera named cam is here: give this one another --name"
    assert LeaderNotice("refused", refusal) in second.events
    rig.kill("cam")
    rig.run_until(lambda: second.client.state is NodeState.READY)
    assert rig.views()["cam"].via == "two"


def test_a_name_that_differs_by_case_alone_is_refused() -> None:
    """On Windows and macOS the two would be one folder."""
    rig = RelayRig()
    one = rig.relay("one", ROOT)
    first = rig.camera("cam", one, at="cam")
    rig.run_until(lambda: first.client.state is NodeState.READY)
    second = rig.camera("Cam", one, at="other")
    rig.run(4.0)
    assert second.client.state is NodeState.JOINING
    refusal = "cam is here, and Cam would be the same folder: give this one another --name"
    assert LeaderNotice("refused", refusal) in second.events


def test_a_relay_that_stops_in_order_sends_its_clients_on_at_once() -> None:
    rig, camera = camera_below_a_relay()
    rig.relays.pop("relay").leave()
    rig.tree.act("relay")
    rig.run(0.2)
    rig.kill("relay")
    assert rig.views()["relay"].report.state is NodeState.LOST
    rig.run_until(lambda: camera.client.state is NodeState.READY)
    assert rig.views()["cam"].via is None


def test_a_promised_burst_survives_the_relay_that_brought_it() -> None:
    rig, camera = camera_below_a_relay()
    burst = rig.trigger(2, after_s=8)
    rig.run(0.5)
    rig.kill("relay")
    rig.run(9.0)
    assert [(e.name, e.refusal) for e in rig.events if isinstance(e, TriggerAnswered)] == [("cam", "")]
    (ready,) = camera.ready
    assert ready.trigger.burst == burst.number
    assert len(ready.frames) == 2
    assert rig.views()["cam"].via is None


def test_a_camera_that_moves_without_having_been_lost_is_not_there_twice() -> None:
    rig, camera = camera_below_a_relay()
    assert rig.views()["cam"].via == "relay", "it had the patience to wait until the relay knew the time"
    camera.client.hellos = 10
    camera.client.lose("it was told to", camera.clock.local_from_true(rig.tree.now_true_ns))
    rig.run_until(lambda: rig.views()["cam"].via is None)
    rig.run(5.0)
    assert NodeChanged("cam", "moved") in rig.events
    assert rig.views()["cam"].via is None
    assert camera.client.state is NodeState.READY
    rig.check_burst()


def test_a_burst_is_taken_while_the_new_leaders_clock_is_still_being_learned() -> None:
    rig, _ = camera_below_a_relay()
    rig.kill("relay")
    rig.run_until(lambda: rig.views()["cam"].via is None)
    rig.check_burst()


def test_the_first_camera_sets_the_rate_though_a_relay_joined_before() -> None:
    rig = RelayRig()
    rig.tree.root.current.config = RequestedConfig()
    relay = rig.relay("relay", ROOT)
    rig.run(3.0)
    camera = structs.replace(CAMERA, period_ns=20_000_000)
    rng = random.Random(1)
    client: Client[int] = Client(ClientConfig("cam", 5, camera, 60_000, 90), rng)
    rig.tree.add("cam", Camera(client, (relay,)), rng, (relay,))
    rig.run(6.0)
    grid = rig.tree.root.grid
    assert grid is not None
    assert grid.period_ns == 20_000_000
    assert rig.relays["relay"].leader.grid == grid
    # A root that is started anew hears of the rate from the first relay.
    relay_node = rig.relays["relay"]
    rig.kill("root")
    rig.run(4.0)
    relay_node.member.handle_timer(relay_node.next_timer() + S)
    hellos = [decode(data) for data, _ in relay_node.member.datagrams_to_send(0)]
    assert [hello.camera.period_ns for hello in hellos if isinstance(hello, Hello)] == [20_000_000]
