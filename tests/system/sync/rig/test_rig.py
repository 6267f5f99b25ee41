"""The whole engine in virtual time: clocks hours apart, phases anywhere, links that lose and reorder."""

from dataclasses import replace
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.simulated.links import Link
from benchmarks.simulated.virtual_rig import VirtualRig
from benchmarks.simulated.wireless import PAPER_LINK, GammaDelay
from capture_app.common.node_state import NodeState
from capture_app.sync.wire.codec import encode
from capture_app.sync.wire.datagrams import (
    Goodbye,
    HeartbeatAck,
    Hello,
    JoinRefusal,
    RigConfigMessage,
    TimeReply,
    Trigger,
    UnknownMember,
    Welcome,
)
from tests.unit.sync.rig.rigs import S, ready_rig
from tests.unit.sync.rig.test_rig import errors_of_burst, specs


def test_five_phones_take_pictures_of_the_same_instant() -> None:
    rig = ready_rig(specs(5, "phone-a", "phone-b"), seed=3)
    errors = errors_of_burst(rig, frames=5)
    assert len(errors) == 25
    assert max(map(abs, errors)) < 150_000


def test_the_hard_bound_holds_for_every_frame_on_the_papers_link() -> None:
    four = [replace(spec, tolerance_ns=250_000) for spec in specs(4, "phone-a", link=PAPER_LINK, seed=5)]
    rig = ready_rig(four, seed=6)
    burst = rig.trigger(frames=10)
    rig.run_for(3 * S)
    for node in rig.nodes.values():
        for pick in node.bursts[burst.number].frames:
            error_ns = pick.leader_ns - (pick.frame.timestamp_true_ns - pick.outlier_ns)
            assert abs(error_ns) <= pick.hard_bound_ns
            assert pick.uncertainty_ns <= pick.hard_bound_ns


def test_the_same_seed_gives_the_same_run() -> None:
    def run() -> list[tuple[str, object]]:
        rig = VirtualRig(specs(2, "phone-a", "webcam", link=PAPER_LINK), seed=11)
        rig.run_for(8 * S)
        return [(name, node.client.report(0)) for name, node in rig.nodes.items()]

    assert run() == run()


u32 = st.integers(0, 2**32 - 1)
times = st.integers(-(2**63), 2**63 - 1)


def forged_config(anchor_leader_ns: int, period_ns: int) -> RigConfigMessage:
    return RigConfigMessage(leader=7, anchor_leader_ns=anchor_leader_ns, period_ns=period_ns)


law = st.just(GammaDelay(50_000, 400_000, outlier_fraction=0.05))
shares = st.floats(0, 0.3)


@settings(max_examples=15, suppress_health_check=[HealthCheck.too_slow])
@given(
    link=st.builds(Link, law, law, shares, shares),
    forged=st.lists(
        st.one_of(
            st.builds(lambda t0, t1, t2: ("time", t0, t1, t2), times, times, times),
            st.builds(lambda a, p: ("welcome", a, p), times, times),
            st.builds(lambda f, s, c: ("trigger", f, s, c), times, times, u32),
            st.builds(lambda a, p: ("alive", a, p), times, times),
            st.sampled_from([("unknown",), ("refused",), ("goodbye",), ("noise",)]),
        ),
        max_size=12,
    ),
    seed=u32,
)
def test_nothing_on_the_network_keeps_a_rig_from_getting_ready(
    link: Link, forged: list[tuple[object, ...]], seed: int
) -> None:
    rig = VirtualRig(specs(1, "perfect", link=link), seed=seed)
    rig.run_for(S)
    node = rig.nodes["cam00"]
    client = node.client.number or 0
    instance = node.client.config.instance
    for kind, *fields in forged:
        more: Any = fields
        message: Any
        match kind:
            case "time":
                message = TimeReply(client, 5, *more)
            case "welcome":
                message = Welcome(instance, client, 1, forged_config(*more))
            case "trigger":
                message = Trigger(client, 7, 9, *more)
            case "unknown":
                message = UnknownMember(client)
            case "alive":
                message = HeartbeatAck(client, forged_config(*more))
            case "refused":
                message = JoinRefusal(instance, "no")
            case "goodbye":
                message = Goodbye(client)
            case _:
                message = Hello("stranger", 1, node.client.config.camera)
        data = encode(message)
        node.client.receive_datagram(data, node.spec.clock.local_from_true(rig.now_true_ns))
        rig.leader.receive_datagram(data, ("cam00", 0), rig.now_true_ns)
        rig.run_for(S // 10)
    rig.run_for(5 * S)
    ready = lambda: rig.nodes["cam00"].client.state is NodeState.READY  # noqa: E731
    assert rig.run_until(ready, limit_ns=60 * S)
