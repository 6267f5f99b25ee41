"""Clients in virtual time that hear the same beacons: they agree; where they cannot, nothing is worse."""

import random
from dataclasses import replace
from itertools import combinations

import pytest

from benchmarks.simulated.radio_cells import BeaconRig, HearingNode, RadioCell, Receiver
from benchmarks.simulated.virtual_rig import VirtualNode, VirtualRig
from benchmarks.simulated.wireless import GammaDelay
from capture_app.common.camera_facts import PhaseControl
from capture_app.common.clock import SimulatedClock
from capture_app.simulation.links import Link
from capture_app.simulation.profiles import PROFILES
from capture_app.sync.timekeeping.clock_events import ReferenceCorrected
from capture_app.sync.wire.codec import decode, encode
from capture_app.sync.wire.messages import AgreedArrival, ArrivalReport, Beacon, Welcome
from tests.simulation.rig.rigs import S, checked_error_ns

US = 1_000
CAMERA = replace(PROFILES["perfect"], phase_control=PhaseControl.NONE, frame_length_rows=10_000)
"""Ten frames a second, wherever they fall: only the clocks are looked at."""
WAYS_US = ((300, 700), (800, 400), (500, 500), (600, 450))
"""Least delays to and from the leader: what no exchange can see is half their difference."""


def link(there_us: int, back_us: int) -> Link:
    return Link(
        GammaDelay(there_us * US, there_us * US + 300 * US, shape=1.0),
        GammaDelay(back_us * US, back_us * US + 300 * US, shape=1.0),
    )


def specs(*cells: RadioCell | None) -> list[HearingNode]:
    rng = random.Random(5)
    return [
        HearingNode(
            f"cam{k}",
            CAMERA,
            SimulatedClock(rng.randrange(-9 * 3600 * S, 9 * 3600 * S), rng.gauss(0.0, 20.0)),
            link(*WAYS_US[k]),
            cell=cell,
            receiver=Receiver(constant_ns=rng.randrange(5 * US)),
        )
        for k, cell in enumerate(cells)
    ]


def errors_us(rig: VirtualRig, node: VirtualNode) -> tuple[float, float]:
    """The node's clock against the leader's, with what was agreed and without; the bounds must hold."""
    maps = node.client.time_map, node.client.time.timekeeper.uncorrected_map
    now, before = (checked_error_ns(time_map, node.spec.clock, rig.now_true_ns) / US for time_map in maps)
    return now, before


def apart_us(rig: VirtualRig, which: int = 0) -> float:
    """Largest difference between two clients: 0 with, 1 without what was agreed."""
    errors = [errors_us(rig, node)[which] for node in rig.nodes.values()]
    return max(abs(a - b) for a, b in combinations(errors, 2))


def run(rig: VirtualRig, seconds: int) -> None:
    for _ in range(seconds):
        rig.run_for(S)
        for node in rig.nodes.values():
            if node.client.time_map is not None:
                errors_us(rig, node)


def told(rig: VirtualRig) -> list[int | None]:
    return [client.report.relative_uncertainty_ns for client in rig.leader.roster.by_name()]


@pytest.mark.slow
def test_clients_of_one_cell_agree_without_the_links_asymmetry() -> None:
    cell = RadioCell()
    rig = BeaconRig(specs(cell, cell, cell), seed=2)
    run(rig, 15)
    assert apart_us(rig, which=1) > 300.0, "what exchanges alone leave"
    assert apart_us(rig) < 25.0
    assert all(stated_ns is not None and stated_ns < 60_000 for stated_ns in told(rig))
    burst = rig.trigger(frames=1)
    run(rig, 3)
    for node in rig.nodes.values():
        relative_ns = node.bursts[burst.number].time_map.relative_uncertainty_ns
        assert relative_ns is not None, "a burst keeps what its clock was"
        assert relative_ns < 60_000


@pytest.mark.slow
@pytest.mark.parametrize(
    "cells",
    [
        (None, None, None),
        (RadioCell(), None, None),
        (RadioCell("one"), RadioCell("other"), RadioCell("third")),
        (RadioCell(copy_ns=300_000),) * 3,
    ],
    ids=["nobody hears", "one hears", "each elsewhere", "copies one after the other"],
)
def test_where_nothing_is_heard_together_all_is_as_before(cells: tuple[RadioCell | None, ...]) -> None:
    rig = BeaconRig(specs(*cells), seed=2)
    run(rig, 15)
    for node in rig.nodes.values():
        assert node.client.time_map == node.client.time.timekeeper.uncorrected_map
        assert node.client.time.malformed == 0
    assert told(rig) == [None] * 3


@pytest.mark.slow
def test_a_cell_does_not_move_those_who_are_not_of_it() -> None:
    cell, other = RadioCell("one"), RadioCell("other")
    rig = BeaconRig(specs(cell, cell, cell, other), seed=3)
    run(rig, 15)
    outsider = rig.nodes["cam3"].client
    assert outsider.time_map == outsider.time.timekeeper.uncorrected_map
    del rig.nodes["cam3"]
    assert apart_us(rig) < 25.0


@pytest.mark.slow
def test_a_cell_that_falls_silent_is_forgotten_softly() -> None:
    cell = RadioCell()
    rig = BeaconRig(specs(cell, cell), seed=2)
    run(rig, 12)
    assert apart_us(rig) < 30.0
    for node in rig.nodes.values():
        assert isinstance(node.spec, HearingNode)
        node.spec = replace(node.spec, cell=None)
    run(rig, 15)
    for node in rig.nodes.values():
        assert node.client.time_map == node.client.time.timekeeper.uncorrected_map
        begun, ended = (event for event in node.events if isinstance(event, ReferenceCorrected))
        assert begun.relative_uncertainty_ns is not None
        assert ended.relative_uncertainty_ns is None


def test_the_same_seed_gives_the_same_run() -> None:
    maps = []
    for _ in range(2):
        rig = BeaconRig(specs(RadioCell(), RadioCell()), seed=4)
        rig.run_for(8 * S)
        maps.append([node.client.time_map for node in rig.nodes.values()])
        assert any(stated_ns is not None for stated_ns in told(rig))
    assert maps[0] == maps[1]


def forged(rng: random.Random, client: int) -> tuple[AgreedArrival, ArrivalReport]:
    """What a stranger might say: numbers and times near the true ones, or anything."""

    def time_ns() -> int:
        return rng.choice([rng.randrange(10**10), rng.randrange(-(2**63), 2**63)])

    def number() -> int:
        return rng.choice([rng.randint(1, 40), rng.randrange(1, 2**32)])

    arrivals = tuple((number(), time_ns()) for _ in range(rng.randint(0, 32)))
    errors_ns = rng.randrange(10**6), rng.randrange(10**18)
    return AgreedArrival(client, number(), time_ns(), *errors_ns), ArrivalReport(client, *errors_ns, arrivals)


@pytest.mark.slow
def test_whatever_is_forged_the_bounds_hold_and_agreement_comes_back() -> None:
    rng = random.Random(7)
    rig = BeaconRig(specs(RadioCell(), RadioCell()), seed=2)
    run(rig, 6)
    leader, nodes = rig.leader, list(rig.nodes.values())
    for node in nodes:
        local_ns = node.spec.clock.local_from_true(rig.now_true_ns)
        client = node.client.time.number
        assert client is not None
        for _ in range(40):
            agreed, heard = forged(rng, client)
            beacon = Beacon(leader.config.instance, agreed.number)
            node.client.receive_broadcast(encode(beacon), local_ns)
            node.client.receive_datagram(encode(agreed), local_ns)
            leader.receive_datagram(encode(heard), (node.spec.name, 0), rig.now_true_ns)
    run(rig, 16)
    assert apart_us(rig) < 40.0


class OldLeader:
    """Takes out of a leader's datagrams what nodes of before do not know."""

    def __init__(self, rig: VirtualRig) -> None:
        self.unknown = 0
        self._send, self._take = rig.leader.datagrams_to_send, rig.leader.receive_datagram
        rig.leader.datagrams_to_send = self.send  # type: ignore[method-assign]
        rig.leader.receive_datagram = self.take  # type: ignore[method-assign, assignment]

    def send(self, now_ns: int) -> list[tuple[bytes, tuple[str, int]]]:
        datagrams = []
        for data, address in self._send(now_ns):
            message = decode(data)
            if isinstance(message, Welcome):
                assert message.beacons is not None
            if not isinstance(message, AgreedArrival):
                datagrams.append((encode(message), address))
        return datagrams

    def take(self, data: bytes, address: tuple[str, int], now_ns: int) -> None:
        if isinstance(decode(data), ArrivalReport):
            self.unknown += 1
        else:
            self._take(data, address, now_ns)


def test_a_leader_that_does_not_answer_changes_nothing() -> None:
    rig = BeaconRig(specs(RadioCell(), RadioCell()), seed=2)
    old = OldLeader(rig)
    run(rig, 8)
    assert old.unknown > 3
    assert all(
        node.client.time_map == node.client.time.timekeeper.uncorrected_map for node in rig.nodes.values()
    )
