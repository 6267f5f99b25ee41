"""Broadcasts in virtual time: radio cells, and a rig whose nodes hear the leader's beacons in them."""

from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.simulated.virtual_rig import NodeSpec, VirtualNode, VirtualRig
from benchmarks.simulated.wireless import GammaDelay
from capture_app.simulation.links import DelayLaw
from capture_app.sync.wire.messages import Group

_US = 1_000
SLOT_NS = 9 * _US
SLOTS = 15
"""An access point waits for 0 to so many slots by chance before it sends (802.11, best effort)."""
USUAL_DELAY = GammaDelay(500 * _US, 1500 * _US, outlier_share=0.01)


@dataclass(frozen=True, slots=True)
class RadioCell:
    """An access point; a packet takes the same time from the leader into the air for all receivers."""

    name: str = "cell"
    delay: DelayLaw = USUAL_DELAY
    loss: float = 0.01
    copy_ns: int | None = None
    """Airtime of a packet, where each client is sent a copy of its own; None for one packet for all."""


@dataclass(frozen=True, slots=True)
class Receiver:
    """A device's delay of reception in ns: a constant and an exponential part; some packets are lost."""

    constant_ns: int = 0
    jitter_ns: int = 5 * _US
    loss: float = 0.02


_PLAIN_RECEIVER = Receiver()


@dataclass(frozen=True, slots=True)
class HearingNode(NodeSpec):
    """A node that receives the broadcasts of a radio cell, if it is in one."""

    cell: RadioCell | None = None
    receiver: Receiver = _PLAIN_RECEIVER


class BeaconRig(VirtualRig):
    """A rig whose leader sends beacons to the nodes of radio cells."""

    def __init__(self, specs: Sequence[HearingNode], *, seed: int) -> None:
        super().__init__(specs, seed=seed, beacons=Group("239.255.47.10", 47011))

    def broadcast(self, data: bytes) -> None:
        """Let the nodes of all cells hear a packet; copies go out in the order in which the nodes started."""
        rng = self._rng
        left_ns: dict[RadioCell, int | None] = {}
        for node in self.nodes.values():
            spec = node.spec
            if not isinstance(spec, HearingNode) or (cell := spec.cell) is None:
                continue
            if cell not in left_ns:
                left_ns[cell] = None if rng.random() < cell.loss else cell.delay.draw(rng, self.now_true_ns)
            since_ns = left_ns[cell]
            if since_ns is None:
                continue
            if cell.copy_ns is not None:
                left_ns[cell] = since_ns + cell.copy_ns + rng.randint(0, SLOTS) * SLOT_NS
            delay_ns = since_ns + spec.receiver.constant_ns
            if spec.receiver.jitter_ns:
                delay_ns += round(rng.expovariate(1.0 / spec.receiver.jitter_ns))
            if rng.random() >= spec.receiver.loss:
                self._time.schedule(self.now_true_ns + delay_ns, self._hear, data, node)

    def _hear(self, data: bytes, node: VirtualNode) -> None:
        if node.alive:
            node.client.receive_broadcast(data, self._local(node))
            self._pump(node)
