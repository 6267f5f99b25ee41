"""What a status says of a node by itself, and in which order it lists nodes."""

import random
from typing import Any

import pytest

from capture_app.common.camera_facts import StampAccuracy, StampSource
from capture_app.common.node_state import WITHOUT_CAMERA, NodeState
from capture_app.protocol.status import NodeStatus, RigStatus, in_tree_order
from tests.facts import make_facts


def node(name: str = "a", **fields: Any) -> NodeStatus:
    facts: dict[str, Any] = {"camera": make_facts(), "state": NodeState.READY, "tolerance_ns": 100} | fields
    return NodeStatus(name=name, address="x", **facts)


def test_a_frames_time_is_as_sure_as_the_clock_and_the_stamps_are_together() -> None:
    stamped = make_facts(stamp=StampAccuracy(bias_ns=0, uncertainty_ns=7, source=StampSource.LIGHT))
    clock = make_facts(kind=next(iter(WITHOUT_CAMERA)), stamp=stamped.stamp)
    for uncertainty_ns, bound_ns, ns in ((50, 90, 50), (None, 90, 90), (0, 90, 0), (None, None, None)):
        of: dict[str, Any] = {"uncertainty_ns": uncertainty_ns, "hard_bound_ns": bound_ns}
        assert node(camera=stamped, **of).time_error_ns == (None if ns is None else ns + 7)
        assert node(camera=clock, **of).time_error_ns == ns


@pytest.mark.parametrize(
    ("state", "error_ns", "is_settled", "is_settling"),
    [
        (NodeState.READY, None, True, False),
        (NodeState.READY, 200, True, False),
        (NodeState.READY, -201, False, False),
        (NodeState.ALIGNING, None, True, True),
        (NodeState.ALIGNING, -200, True, False),
        (NodeState.ALIGNING, 201, False, True),
        (NodeState.FAILED, 0, False, True),
        (NodeState.LOST, 0, False, False),
    ],
)
def test_a_camera_is_waited_for_until_it_is_near_the_grid(
    state: NodeState, error_ns: int | None, is_settled: bool, is_settling: bool
) -> None:
    status = node(state=state, phase_error_ns=error_ns)
    assert (status.is_settled, status.is_settling) == (is_settled, is_settling)


def test_nodes_follow_their_relays_and_each_is_listed_once() -> None:
    parents = {"b": None, "a": "c", "c": None, "d": "a", "e": "gone", "x": "y", "y": "x"}
    nodes = [node(name, parent=parent) for name, parent in parents.items()]
    random.Random(1).shuffle(nodes)
    assert [of.name for of in in_tree_order(tuple(nodes))] == ["b", "c", "a", "d", "e", "y", "x"]


def test_a_staggered_rig_says_its_order() -> None:
    def order(stagger: str, steps: str = "steps of 8 ms") -> str:
        return RigStatus(leader="x", now_ns=0, period_ns=1, stagger=stagger, steps=steps).order

    assert (order(""), order("even"), order("a,b")) == (
        "", "stagger: even, steps of 8 ms", "stagger: steps of 8 ms",
    )  # fmt: skip


def test_cameras_are_the_nodes_that_have_one_and_are_called_as_people_call_them() -> None:
    nodes = (
        node("a", camera=make_facts(label="Böhm")),
        node("b", camera=make_facts(kind=min(WITHOUT_CAMERA))),
    )
    rig = RigStatus(leader="x", now_ns=0, period_ns=1, nodes=nodes)
    assert [of.name for of in rig.cameras] == ["a"]
    assert rig.titles == {"a": "Böhm", "b": "b"}
