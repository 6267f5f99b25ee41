"""Error bars of frames as stated and as widened afterwards: a suspended leader, and slewed clocks.

Rigs of two cameras in virtual time; 15 s of frames, of which the change touches some. The truth of a time is
the leader's clock, which stands still while its machine is suspended. A row counts the frames from the change
until a second after it was noticed, by all cameras that it concerns. Simulated.
"""

from typing import Any

from benchmarks.report import Columns, Report, new_parser, print_report, print_rows
from benchmarks.simulated.changing_clocks import ChangingClock, RateSpell
from benchmarks.simulated.links import Link
from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from benchmarks.simulated.wireless import PAPER_LINK, GammaDelay
from capture_app.common.clock import NodeClock, SimulatedClock
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.sync.timekeeping.clock_events import TimesDoubted

S = 1_000_000_000
SETTLE_NS, BEGINS_NS, LASTS_NS = 30 * S, 3 * S, 12 * S
LINKS = {"wire": Link(GammaDelay(60_000, 90_000), GammaDelay(60_000, 90_000)), "paper's": PAPER_LINK}
CHANGES = {"suspended 1 s": 1.0, "suspended 5 s": 5.0, "slewed 80 ppm": 80.0, "slewed 500 ppm": 500.0}
COLUMNS: Columns = {
    "change": ("change", ""),
    "link": ("link", ""),
    "frames": ("frames", ""),
    "stated": ("held as stated", ".0%"),
    "widened": ("held afterwards", ".0%"),
    "noticed_s": ("noticed after s", ".1f"),
}


def measure_change(change: str, link: str, seed: int) -> tuple[int, int, int, float]:
    """Return the touched frames, those whose bars held as stated and afterwards, and the delay in s."""
    amount, sleeps, at_ns = CHANGES[change], change.startswith("suspended"), SETTLE_NS + BEGINS_NS
    slews = () if sleeps else (RateSpell(at_ns, at_ns + LASTS_NS, amount * 1e-6),)
    clocks: tuple[NodeClock, ...] = (SimulatedClock(0, -12.0), ChangingClock(3600 * S, 10e-6, 0, slews))
    specs = [NodeSpec(f"cam{n}", PROFILES["pi"], clock, LINKS[link]) for n, clock in enumerate(clocks)]
    rig = VirtualRig(specs, seed=seed)
    rig.run_for(SETTLE_NS)
    burst = rig.trigger(frames=10_000, streamed=True)
    rig.run_for(BEGINS_NS)
    if sleeps:
        rig.suspend_leader()
        rig.run_for(round(amount * S))
        rig.wake_leader()
    woke_ns = rig.now_true_ns
    rig.run_for(LASTS_NS)
    frames = stated = widened = 0
    noticed_ns = at_ns
    for node in rig.nodes.values() if sleeps else [rig.nodes["cam1"]]:
        clock, doubts = node.spec.clock, [one for one in node.events if isinstance(one, TimesDoubted)]
        until_ns = max((clock.true_from_local(one.until_local_ns) for one in doubts), default=at_ns)
        noticed_ns = max(noticed_ns, until_ns)
        for pick in node.bursts[burst.number].frames:
            true_ns = clock.true_from_local(pick.local_ns)
            if not at_ns <= true_ns <= until_ns + S:
                continue
            slept_ns = max(0, min(true_ns, woke_ns) - at_ns) if sleeps else 0
            error_ns = abs(pick.leader_ns - (true_ns - slept_ns))
            bars_ns = [
                one.error_ns for one in doubts if one.from_local_ns <= pick.local_ns <= one.until_local_ns
            ]
            frames += 1
            stated += error_ns <= pick.uncertainty_ns
            widened += error_ns <= max([pick.uncertainty_ns, *bars_ns])
    return frames, stated, widened, (noticed_ns - (woke_ns if sleeps else at_ns)) / S


def measure(seeds: int) -> Report:
    """Return a row for each change and link: all touched frames of all seeds."""
    rows: list[dict[str, Any]] = []
    for change in CHANGES:
        for link in LINKS:
            found = [measure_change(change, link, seed) for seed in range(seeds)]
            frames, stated, widened = (sum(one[k] for one in found) for k in range(3))
            rows.append(
                {
                    "change": change,
                    "link": link,
                    "frames": frames,
                    "stated": stated / max(frames, 1),
                    "widened": widened / max(frames, 1),
                    "noticed_s": sum(one[3] for one in found) / seeds,
                }
            )
    return {"kind": "simulated", "seeds": seeds, "changes": rows}


def main() -> None:
    """Measure and print."""
    parser = new_parser(__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="rigs of each row (5)")
    options = parser.parse_args()
    report = measure(options.seeds)
    print_report(report, lambda found: print_rows(found["changes"], COLUMNS), as_json=options.json)


if __name__ == "__main__":
    main()
