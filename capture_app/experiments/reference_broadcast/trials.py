"""Trials of `reference-broadcast`: some clients in virtual time, judged twice a second, with and without.

With and without are of one run: a client knows its clock before and after the correction.
"""

import random
from dataclasses import dataclass, replace

from capture_app.clock import SimulatedClock
from capture_app.simulation.links import GammaDelay, Link, RadioCell, Receiver
from capture_app.simulation.paper_link import PAPER_LINK
from capture_app.simulation.profiles import PROFILES
from capture_app.simulation.rig import NodeSpec, VirtualNode, VirtualRig
from capture_app.sync.clock.time_map import TimeMap

S, US, HOURS_NS = 1_000_000_000, 1_000, 9 * 3600 * 1_000_000_000
EVERY_NS = S // 2
LEAST_US = (300.0, 900.0)
"""Least delay of each way of a link that is drawn; half the difference of the two cannot be measured."""
TAILS_US = (1399.0, 616.0)
"""Mean delay beyond the least, to the leader and from it: as the paper's beyond its quickest message."""
FAR_TOO_LATE = 0.0064
RECEIVER_US = 10
"""A receiver's own delay is drawn up to this; what comes by chance has a mean of half of it."""
LATE_US = 400
SKEW_PPM = 20.0
CAMERA = replace(PROFILES["perfect"], frame_length_rows=10_000)
"""Only the clocks are looked at: ten frames a second are less work, and they are left where they are."""


@dataclass(frozen=True, slots=True)
class Case:
    """Some clients: the radio cell of each, their links and receivers."""

    title: str
    cells: tuple[RadioCell, ...]
    drawn: bool = True
    late_receivers: int = 0
    """So many, the last ones, have a receiver that is always late."""

    def pairs_of_good_receivers(self, *, together: bool) -> list[tuple[int, int]]:
        """Pairs of clients without late receivers, of one cell or of two."""
        well = range(len(self.cells) - self.late_receivers)
        return [(i, j) for i in well for j in well if i < j and (self.cells[i] == self.cells[j]) is together]


ONE, OTHER, COPYING = RadioCell("one"), RadioCell("other"), RadioCell("copying", copy_ns=300 * US)
CASES = {
    "paper_link": Case("five on the paper's link", (ONE,) * 5, drawn=False),
    "drawn_links": Case("five on links of their own", (ONE,) * 5),
    "pair": Case("the same, only two", (ONE,) * 2),
    "slow_receiver": Case("the same, one of five hears 400 us late", (ONE,) * 5, late_receivers=1),
    "two_cells": Case("the same, two access points", (ONE,) * 3 + (OTHER,) * 3),
    "copies": Case("the same, each is sent its own copy", (COPYING,) * 5),
}


@dataclass(frozen=True, slots=True)
class Reading:
    """A clock's error, its stated 95 % and its bound, in us."""

    error_us: float
    uncertainty_us: float
    bound_us: float


@dataclass(frozen=True, slots=True)
class Moment:
    """All clients at one moment: their clocks before and after the correction, and what they state of it."""

    at_s: float
    uncorrected: tuple[Reading, ...]
    corrected: tuple[Reading, ...]
    relative_uncertainty_us: tuple[float | None, ...]


def run_trial(case: Case, seed: str, seconds: int) -> list[Moment]:
    """Let some clients start within a second; return the moments of so long at which all know the time."""
    rng = random.Random(seed)
    specs = [_draw_spec(k, case, rng) for k in range(len(case.cells))]
    rig = VirtualRig(specs, seed=rng.getrandbits(32), beacons=True)
    moments = []
    for _ in range(seconds * S // EVERY_NS):
        rig.run_for(EVERY_NS)
        # The rig has them in the order in which they started.
        nodes = [rig.nodes[spec.name] for spec in specs if spec.name in rig.nodes]
        if len(nodes) == len(specs) and all(node.client.time.uncorrected_map is not None for node in nodes):
            moments.append(_observe(rig, nodes))
    return moments


def _draw_spec(k: int, case: Case, rng: random.Random) -> NodeSpec:
    link = PAPER_LINK
    if case.drawn:
        to_leader_us, to_client_us = TAILS_US
        link = Link(_draw_delay(to_leader_us, rng), _draw_delay(to_client_us, rng))
    late_us = LATE_US if k >= len(case.cells) - case.late_receivers else 0
    return NodeSpec(
        f"client{k}",
        CAMERA,
        SimulatedClock(rng.randrange(-HOURS_NS, HOURS_NS), rng.gauss(0.0, SKEW_PPM)),
        link,
        tolerance_ns=S,
        start_true_ns=rng.randrange(S),
        cell=case.cells[k],
        receiver=Receiver(rng.randrange(RECEIVER_US * US) + late_us * US, RECEIVER_US * US // 2),
    )


def _draw_delay(tail_us: float, rng: random.Random) -> GammaDelay:
    least_ns = round(rng.uniform(*LEAST_US) * US)
    return GammaDelay(least_ns, least_ns + round(tail_us * US), outlier_share=FAR_TOO_LATE)


def _observe(rig: VirtualRig, nodes: list[VirtualNode]) -> Moment:
    reports = [node.client.report(node.spec.clock.local_from_true(rig.now_true_ns)) for node in nodes]
    relative_ns = [report.relative_uncertainty_ns for report in reports]
    return Moment(
        rig.now_true_ns / S,
        tuple(_read_clock(rig, node, node.client.time.uncorrected_map) for node in nodes),
        tuple(_read_clock(rig, node, node.client.time_map) for node in nodes),
        tuple(None if ns is None else ns / US for ns in relative_ns),
    )


def _read_clock(rig: VirtualRig, node: VirtualNode, time_map: TimeMap | None) -> Reading:
    assert time_map is not None
    local_ns = node.spec.clock.local_from_true(rig.now_true_ns)
    error_ns = time_map.leader_from_local(local_ns) - rig.now_true_ns
    return Reading(
        error_ns / US, time_map.uncertainty_at(local_ns) / US, time_map.hard_bound_at(local_ns) / US
    )
