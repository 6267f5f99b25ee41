"""Five phones: their synchronization time, the error of the worst pair, and a burst of five views."""

import random
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from benchmarks.paper.reproduction import Measured, Reproduction
from benchmarks.paper.trials import call_all, share_of
from benchmarks.paper.values import BURST, START_UP, WORST_PAIR
from benchmarks.simulated.links import TURNAROUND_NS
from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from benchmarks.simulated.wifi_laws import LOOPBACK
from benchmarks.simulated.wireless import PAPER_LINK
from capture_app.common.clock import SimulatedClock
from capture_app.common.errors import IncompleteError
from capture_app.console.terminal import talk
from capture_app.plugins.cameras.sim.profiles import PROFILES, SensorProfile
from capture_app.sync.rig.client import PHASE_TOLERANCE_NS

TRIALS = 100
PHONES, FRAMES = 5, 5
MESSAGES = 300
"""K of the paper."""
PAPERS_TOLERANCE_NS = 20_000
EXPOSURE_NS = 43_000
READY_NS, BURST_NS = 120_000_000_000, 3_000_000_000
HOURS_NS = 9 * 3600 * 1_000_000_000
SKEW_PPM = 15.0
"""Standard deviation of the clients' skew."""
SIMULATED = (
    "Phones, clocks (15 ppm, one sigma) and the paper's link; the leader's own camera is one of the five."
)


@dataclass(frozen=True, slots=True)
class RigTrial:
    """Result of one rig: seconds from its start, differences of images' true times in us."""

    clocks_s: float
    """Time until all clocks were synchronized."""
    one_clock_s: float
    """Time until one client's clock was synchronized, on average."""
    ready_s: float
    pair_us: float
    """Worst pair of the burst's first instant."""
    apart_us: float
    """Worst pair of any instant of the burst."""
    missing: int
    """Frames of the burst that were missing on some phone."""


def paper_part(*, share: float, seed: int) -> Sequence[Reproduction]:
    """Measure the worst pair, the start and the bursts; the same trials give all three."""
    count = share_of(TRIALS, share, least=1)
    calls = [
        partial(run_trial, f"{seed} {n}", tolerance_ns)
        for tolerance_ns in (PAPERS_TOLERANCE_NS, None)
        for n in range(count)
    ]
    done = call_all(calls)
    talk(f"{count} rigs of {PHONES} phones, twice")
    papers, ours = done[:count], done[count:]
    in_turn = [synchronize_in_turn(random.Random(f"{seed} {n} in turn")) for n in range(count)]
    setups = [f"phases to {ns / 1000:.0f} us" for ns in (PAPERS_TOLERANCE_NS, PHASE_TOLERANCE_NS)]

    def pairs(trials: list[RigTrial], setup: str) -> Measured:
        worst = [trial.pair_us for trial in trials]
        return Measured({"pair.max": max(worst), "pair.mean": sum(worst) / count}, count, setup)

    def bursts(trials: list[RigTrial], setup: str) -> Measured:
        values = {
            "views": float(PHONES),
            "frames": float(FRAMES),
            "missing": float(sum(trial.missing for trial in trials)),
            "apart.max": max(trial.apart_us for trial in trials),
        }
        return Measured(values, count, setup)

    return [
        Reproduction(
            of=WORST_PAIR,
            protocol=pairs(papers, setups[0]),
            default=pairs(ours, setups[1]),
            simulated=SIMULATED,
            notes=("The paper states twice its largest error of a client; ours is the error of the pair.",),
        ),
        Reproduction(
            of=START_UP,
            protocol=Measured(
                {
                    "five.max": max(sum(seconds) for seconds in in_turn),
                    "five.mean": sum(map(sum, in_turn)) / count,
                    "one.mean": sum(map(sum, in_turn)) / count / (PHONES - 1),
                },
                count,
                f"the clients in turn, {MESSAGES} messages each, one after the other",
            ),
            default=Measured(
                {
                    "five.max": max(trial.clocks_s for trial in ours),
                    "five.mean": sum(trial.clocks_s for trial in ours) / count,
                    "one.mean": sum(trial.one_clock_s for trial in ours) / count,
                    "ready.mean": sum(trial.ready_s for trial in ours) / count,
                },
                count,
                "the clients at once, until clocks are as good as the link can bear",
            ),
            simulated="The same five phones.",
            notes=("By default the leader's own camera counts, too.",),
        ),
        Reproduction(
            of=BURST,
            protocol=bursts(papers, setups[0]),
            default=bursts(ours, setups[1]),
            simulated="The same five phones.",
            notes=(
                f"{FRAMES} frames of {EXPOSURE_NS // 1000} us in a row. A sensor drops one frame in a "
                "hundred.",
            ),
        ),
    ]


def synchronize_in_turn(rng: random.Random) -> list[float]:
    """Return the seconds per client if the leader asks one after the other, one message at a time."""
    channel, now_ns, took_s = PAPER_LINK.open(), 0, []
    for _ in range(PHONES - 1):
        began_ns = now_ns
        for _ in range(MESSAGES):
            now_ns += min(channel.deliveries("to_client", now_ns, rng)) + TURNAROUND_NS
            now_ns += min(channel.deliveries("to_leader", now_ns, rng))
        took_s.append((now_ns - began_ns) / 1e9)
    return took_s


def run_trial(seed: str, tolerance_ns: int | None) -> RigTrial:
    """Start five phones of unknown models, and take a burst as soon as they are ready."""
    rng = random.Random(seed)
    specs = [NodeSpec("leader", _phone(rng), SimulatedClock(0), LOOPBACK, tolerance_ns)]
    for number in range(1, PHONES):
        clock = SimulatedClock(rng.randrange(-HOURS_NS, HOURS_NS), rng.gauss(0.0, SKEW_PPM))
        specs.append(NodeSpec(f"client-{number}", _phone(rng), clock, PAPER_LINK, tolerance_ns))
    rig = VirtualRig(specs, seed=rng.getrandbits(32))
    synced_s: dict[str, float] = {}

    def all_synced() -> bool:
        for name, node in rig.nodes.items():
            if name not in synced_s and node.client.timekeeper.synced:
                synced_s[name] = rig.now_true_ns / 1e9
        return len(synced_s) == PHONES

    if not rig.run_until(all_synced, limit_ns=READY_NS) or not rig.run_until(
        rig.all_usable, limit_ns=READY_NS
    ):
        raise IncompleteError("the simulated rig did not get ready in two minutes")
    ready_s = rig.now_true_ns / 1e9
    burst = rig.trigger(frames=FRAMES)
    rig.run_for(BURST_NS)
    starts: dict[int, list[int]] = {}
    for node in rig.nodes.values():
        for pick in node.bursts[burst.number].frames if burst.number in node.bursts else ():
            starts.setdefault(pick.instant, []).append(pick.frame.start_true_ns)
    apart_us = {instant: _worst_us(times) for instant, times in starts.items()}
    clients_s = [at_s for name, at_s in synced_s.items() if name != "leader"]
    return RigTrial(
        clocks_s=max(synced_s.values()),
        one_clock_s=sum(clients_s) / len(clients_s),
        ready_s=ready_s,
        pair_us=apart_us[min(apart_us)],
        apart_us=max(apart_us.values()),
        missing=PHONES * FRAMES - sum(len(times) for times in starts.values()),
    )


def _phone(rng: random.Random) -> SensorProfile:
    """Return a phone with unknown overhead."""
    return replace(
        PROFILES["phone-a"],
        exposure_ns=EXPOSURE_NS,
        min_exposure_ns=EXPOSURE_NS,
        margin_rows=rng.randint(2, 60),
    )


def _worst_us(times_ns: Sequence[int]) -> float:
    """Return the largest difference of any two."""
    return (max(times_ns) - min(times_ns)) / 1000.0
