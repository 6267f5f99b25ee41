"""One trial of two phones before the LED panel, one at the leader, one on its WiFi (paper, section 6.1)."""

import random
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from benchmarks.paper.five_phones import PAPERS_TOLERANCE_NS
from benchmarks.simulated.panel_photographs import difference_ns, read_time
from benchmarks.simulated.virtual_rig import NodeSpec, VirtualNode, VirtualRig
from benchmarks.simulated.wifi_laws import LOOPBACK
from benchmarks.simulated.wireless import PAPER_LINK
from capture_app.common.clock import SimulatedClock
from capture_app.common.errors import IncompleteError
from capture_app.companions.panel.panel_photograph import Image, render
from capture_app.plugins.cameras.sim.profiles import PROFILES, SensorProfile
from capture_app.plugins.cameras.sim.sensor import SensorFrame
from capture_app.sync.timekeeping.poll_schedule import NEVER_NS, Progress, SteadySchedule


class OnceSchedule(SteadySchedule):
    """Schedule that asks in quick succession until it has this many answers, and then stops."""

    def __init__(self, messages: int) -> None:
        super().__init__()
        self.min_samples = messages

    def request_sent(self, now_ns: int, progress: Progress) -> None:
        """Record a request, and schedule the next."""
        super().request_sent(now_ns, progress)
        if progress.samples >= self.min_samples:
            self.request_due_ns = NEVER_NS

    def reply_arrived(self, now_ns: int, round_trip_ns: int, progress: Progress) -> bool:
        """Record a reply; return whether the next request is to be sent at once."""
        at_once = super().reply_arrived(now_ns, round_trip_ns, progress)
        if progress.samples >= self.min_samples:
            self.request_due_ns = NEVER_NS
        return at_once and progress.samples < self.min_samples


EXPOSURE_NS = 100_000
PICK_NS = 1_500_000_000
"""Time after its instants at which a burst is picked."""
READY_NS = 60_000_000_000
HOURS_NS = 9 * 3600 * 1_000_000_000
LEAST_STRETCH_NS = 2_000_000
"""Minimum of the random long exposure that resets a phase, beyond a period."""


@dataclass(frozen=True, slots=True)
class PanelProtocol:
    """How two phones are synchronized before each image."""

    tolerance_ns: int | None
    """Requested tolerance of phase and clock; None for the defaults."""
    messages: int | None = None
    """Number of messages after which a clock stops asking; None for the default behaviour."""
    anew: bool = False
    """Whether the phones were in phase before: clocks are reset, and random long exposures reset the phases.

    The link is then as at first. Otherwise everything is new, including the phones' models.
    """
    skew_ppm: float = 15.0
    """Standard deviation of the client's skew."""


PAPERS = PanelProtocol(PAPERS_TOLERANCE_NS, messages=300, anew=True, skew_ppm=0.3)
"""The paper's clocks were stable for an hour; its convergence plot shows no drift to some 10 us in 34 s."""
DEFAULT = PanelProtocol(None)


@dataclass(frozen=True, slots=True)
class Trial:
    """Errors of one trial in us, client minus leader: decoded from the images, true, and its two parts."""

    decoded_us: float
    true_us: float
    clock_us: float
    phase_us: float
    pictures: tuple[Image, Image] | None


@dataclass(frozen=True, slots=True)
class Shot:
    """A node's image of a burst: its frame, and its distance from the burst's instant by its own clock."""

    frame: SensorFrame
    phase_error_ns: int


def run_trial(rng: random.Random, protocol: PanelProtocol = PAPERS, *, keep: bool = False) -> Trial:
    """Run one trial with new clocks and phases; devices are new to the rig, or were in phase before.

    The image is requested as soon as both phones are ready, for half a second later, as with any burst.
    `keep` stores its images.
    """
    phones = [_draw_phone(rng) for _ in range(2)]
    clock = SimulatedClock(rng.randrange(-HOURS_NS, HOURS_NS), rng.gauss(0.0, protocol.skew_ppm))
    once = protocol.messages is not None
    schedule = partial(OnceSchedule, protocol.messages) if protocol.messages is not None else SteadySchedule
    leader_spec = NodeSpec("leader", phones[0], SimulatedClock(0), LOOPBACK, protocol.tolerance_ns)
    client_spec = NodeSpec("client", phones[1], clock, PAPER_LINK, protocol.tolerance_ns)
    rig = VirtualRig(
        [
            replace(leader_spec, schedule=schedule, any_clock=once),
            replace(client_spec, schedule=schedule, any_clock=once),
        ],
        seed=rng.getrandbits(32),
    )
    _wait(rig)
    if protocol.anew:
        for node in rig.nodes.values():
            period_ns = node.spec.profile.period_ns
            node.sensor.inject(period_ns + rng.randrange(LEAST_STRETCH_NS, period_ns), rig.now_true_ns)
            node.channel = node.spec.link.open()
        rig.restart_leader()
        _wait(rig)
    while True:
        number = rig.trigger(frames=1).number
        rig.run_for(PICK_NS)
        shots = [_find_shot(rig.nodes[name], number) for name in ("leader", "client")]
        if all(shots):
            break
        # A dropped frame; the paper's phones would have been asked again, too.
    leader, client = (shot for shot in shots if shot is not None)
    pictures, times_ns = [], []
    for node, shot in zip(rig.nodes.values(), (leader, client), strict=True):
        rows = {"exposure_ns": shot.frame.exposure_ns, "row_time_ns": node.spec.profile.row_time_ns}
        noise = np.random.default_rng(rng.getrandbits(32))
        ppm = node.sensor.period_error_ppm
        pictures.append(render(shot.frame.start_true_ns, rng=noise, true_ppm=ppm, **rows))
        times_ns.append(read_time(pictures[-1], **rows))
    true_ns = client.frame.start_true_ns - leader.frame.start_true_ns
    phase_ns = client.phase_error_ns - leader.phase_error_ns
    return Trial(
        decoded_us=difference_ns(times_ns[1], times_ns[0]) / 1000,
        true_us=true_ns / 1000,
        clock_us=(true_ns - phase_ns) / 1000,
        phase_us=phase_ns / 1000,
        pictures=(pictures[0], pictures[1]) if keep else None,
    )


def _wait(rig: VirtualRig) -> None:
    if not rig.run_until(rig.all_usable, limit_ns=READY_NS):
        raise IncompleteError("the simulated rig did not get ready in a minute")


def _draw_phone(rng: random.Random) -> SensorProfile:
    """Return a phone with the paper's row time, unknown overhead, and an exposure of 100 us."""
    return replace(
        PROFILES["phone-a"],
        exposure_ns=EXPOSURE_NS,
        margin_rows=rng.randint(2, 60),
    )


def _find_shot(node: VirtualNode, number: int) -> Shot | None:
    """Return the image of a burst; None if its frame was dropped."""
    ready = node.bursts.get(number)
    if ready is None or not ready.frames:
        return None
    pick = ready.frames[0]
    true_ns = pick.frame.start_true_ns
    leader_ns = ready.time_map.leader_from_local(node.spec.clock.local_from_true(true_ns))
    return Shot(
        frame=pick.frame,
        phase_error_ns=leader_ns - (pick.leader_ns - pick.residual_ns),
    )
