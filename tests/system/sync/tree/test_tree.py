"""A tree of relays in virtual time: budgets add up, bounds hold, a dead relay is replaced, bytes repeat."""

from dataclasses import replace
from itertools import pairwise

from benchmarks.simulated.clock_tree import Tree, measure, run_shard
from capture_app.common.node_state import NodeState
from capture_app.sync.rig.failover import MIN_ANSWERS, PROBE_EVERY_NS
from tests.unit.sync.rig.rigs import S, checked_error_ns
from tests.unit.sync.tree.test_tree import SMALL


def test_everybody_gets_the_time_and_every_hard_bound_holds() -> None:
    result = run_shard(SMALL, 5, 0, 1)
    assert result.judged > 80
    assert result.within_bound == result.judged
    assert result.within_95 >= 0.93 * result.judged
    assert max(abs(error) for error in result.errors_us[-1]) < 300.0


def test_clients_of_a_dead_relay_join_another_and_hold_the_time_meanwhile() -> None:
    spec = replace(SMALL, duration_s=30.0)
    tree = Tree(spec, seed=3)
    tree.time.schedule(10 * S, tree.kill, "relay0")
    result = measure(tree)
    assert result.within_bound == result.judged
    assert max(abs(error) for errors in result.errors_us[5:] for error in errors) < 400.0
    for number in range(spec.clients):
        member = tree.nodes[f"client{number}", 0].member
        assert member is not None
        assert member.time.state is NodeState.READY
        assert member.leader != ("relay0", 0)
        relay = tree.nodes[member.leader].member
        assert relay is not None
        assert member.time.timekeeper.path == (1, relay.time.instance)


def test_clients_go_back_to_their_own_relay_once_it_has_been_there_for_a_while() -> None:
    back_s = 20
    spec = replace(
        SMALL,
        clients=6,
        duration_s=130.0,
        client_pace_s=0.4,
        relay_pace_s=0.4,
    )
    tree = Tree(spec, seed=3)
    tree.time.schedule(10 * S, tree.kill, "relay0")
    tree.time.schedule(back_s * S, tree.revive, "relay0")
    nodes = [tree.nodes[f"client{number}", 0] for number in range(spec.clients)]
    parents: list[list[str]] = []

    def look() -> None:
        followers = [node.member for node in nodes if node.member is not None]
        parents.append([member.leader[0] for member in followers])
        for node, member in zip(nodes, followers, strict=True):
            # Whatever happens, they hold the time; another relay is asked at its own pace, here 0.4 s, so
            # that they know less for a while, and say so.
            if tree.now_true_ns > 5 * S:
                time_map = member.time.time_map
                error_ns = abs(checked_error_ns(time_map, node.clock, tree.now_true_ns))
                assert time_map is not None
                told_ns = time_map.uncertainty_at(node.clock.local_from_true(tree.now_true_ns))
                assert error_ns <= min(told_ns, 1e6)

    tree.run(look)
    at_first = parents[9]
    assert sorted(set(at_first)) == ["relay0", "relay1", "relay2"]
    # It is trusted no sooner than after a minute; then all go back, and stay.
    a_minute_later = back_s + MIN_ANSWERS * PROBE_EVERY_NS // S
    assert all("relay0" not in now for now in parents[20 : a_minute_later - PROBE_EVERY_NS // S])
    assert parents[-1] == at_first
    changes = [sum(a != b for a, b in pairwise(one)) for one in zip(*parents[9:], strict=True)]
    assert all(count <= 3 for count in changes)
