"""A rig's nodes as a tree."""

import dataclasses

import msgspec
from msgspec import structs

from capture_app.common.node_state import RELAY, NodeState
from capture_app.node.leader.snapshots import node_statuses, page_of, present_cameras
from capture_app.protocol.messages import SpoolSpace
from capture_app.protocol.orders import CameraHealth
from capture_app.protocol.status import NodeStatus, in_tree_order
from capture_app.sync.rig.roster import Member
from capture_app.sync.wire.datagrams import Report
from tests.facts import make_facts

CAMERA = make_facts()


def view(name: str, via: str | None = None, *, relay: bool = False, lost: bool = False) -> Member:
    state = NodeState.LOST if lost else NodeState.READY
    camera = structs.replace(CAMERA, kind=RELAY) if relay else CAMERA
    return Member(name, 1, 1, ("10.0.0.1", 5), camera, Report(state=state), 0, 0.0, via)


def test_each_relay_is_followed_by_what_is_below_it_and_depths_are_counted() -> None:
    cameras = view("a", "z"), view("b"), view("c", "y"), view("d", "gone")
    views = (*cameras, view("y", "z", relay=True), view("z", relay=True))
    nodes = tuple(in_tree_order(node_statuses(views, now_ns=0)))
    shown = [f"{node.name} {node.depth}" for node in nodes]
    assert shown == ["b 1", "d 2", "z 1", "a 2", "y 2", "c 3"]


def test_nodes_that_are_said_to_be_below_each_other_are_all_shown_once() -> None:
    views = (view("a", "b", relay=True), view("b", "a", relay=True), view("c", "c", relay=True))
    nodes = [node.name for node in in_tree_order(node_statuses(views, now_ns=0))]
    assert sorted(nodes) == ["a", "b", "c"]


def test_relays_and_lost_nodes_take_no_pictures() -> None:
    views = (view("a"), view("b", lost=True), view("c", relay=True))
    assert [here.name for here in present_cameras(views)] == ["a"]


def test_a_spool_in_a_long_path_leaves_a_status_that_operators_can_read() -> None:
    space = SpoolSpace(camera="a", free_bytes=0, spool="/", problem="cannot write " + "x" * 900)
    (status,) = node_statuses((view("a"),), now_ns=0, spools={"a": space})
    read = msgspec.json.decode(msgspec.json.encode(status), type=NodeStatus)
    assert read.message.startswith("cannot write xxx")


def test_a_node_is_shown_with_its_health_its_disk_and_where_it_runs() -> None:
    space = SpoolSpace(camera="a", free_bytes=7, spool="/")
    health = {"a": CameraHealth(fps=30.0, gain=2.0)}
    views = (view("a"), view("b"))
    heard = dataclasses.replace(views[0], last_heard_ns=40), views[1]
    a, b = node_statuses(heard, now_ns=100, health=health, spools={"a": space}, local={"a": "sim:pendulum"})
    assert (a.fps, a.gain, a.disk_free_bytes, a.last_seen_ns) == (30.0, 2.0, 7, 60)
    assert (a.on_leader, a.spec, a.address) == (True, "sim:pendulum", "10.0.0.1:5")
    assert (b.fps, b.gain, b.disk_free_bytes, b.on_leader, b.spec) == (None, None, None, False, "")


def test_a_problem_of_a_disk_is_told_by_nodes_that_have_no_other() -> None:
    spools = {"a": SpoolSpace(camera="a", free_bytes=0, spool="/", problem="its disk is full")}

    def message(member: Member) -> str:
        return node_statuses((member,), now_ns=0, spools=spools)[0].message

    assert message(view("a")) == "its disk is full"
    busy = dataclasses.replace(view("a"), report=Report(state=NodeState.FAILED, message="no frames"))
    assert message(busy) == "no frames"
    assert (message(view("a", lost=True)), message(view("b"))) == ("", "")


def test_a_page_says_in_which_states_the_further_nodes_are() -> None:
    views = (view("a"), view("b"), view("c", lost=True), view("d"), view("e"))
    page, further, words = page_of(views, "a", 1)
    assert ([here.name for here in page], further) == (["b"], 3)
    assert words == "and 3 more nodes, not listed here: 1 lost, 2 ready"
    assert page_of(views, "", 5) == (views, 0, "")
    assert page_of(views, "d", 2) == (views[4:], 0, "")
