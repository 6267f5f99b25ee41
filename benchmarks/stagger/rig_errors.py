"""Errors and readiness of rigs of four cameras in virtual time: in step, and staggered, by the same seeds.

Each camera has a clock of its own (hours off, 15 ppm, one sigma) on the paper's WiFi link. An error is the
true start of a frame minus its planned time. Simulated.
"""

import random
from itertools import pairwise
from typing import Any

from benchmarks.report import Columns, Report, new_parser, print_report, print_rows
from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from benchmarks.simulated.wireless import PAPER_LINK
from capture_app.common.clock import SimulatedClock
from capture_app.common.stagger import Stagger
from capture_app.plugins.cameras.sim.profiles import PROFILES

CAMERAS, FRAMES, S = 4, 15, 1_000_000_000
READY_LIMIT_NS, SETTLE_NS, BURST_NS = 200 * S, S, 4 * S
HOURS_NS, SKEW_PPM = 9 * 3600 * S, 15.0
COLUMNS: Columns = {
    "camera": ("cameras", ""),
    "order": ("order", ""),
    "ready_s": ("ready s", ".1f"),
    "ready_max_s": ("at most", ".1f"),
    "mean_us": ("error us", ".1f"),
    "max_us": ("at most", ".0f"),
    "step_ms": ("step ms", ".2f"),
    "frames": ("frames", ""),
}


def trial(camera: str, seed: int, stagger: Stagger | None) -> tuple[float, list[float], list[float]]:
    """Return when a rig was ready (s), the errors of a burst's frames (us), and its merged steps (ms)."""
    rng = random.Random(seed)
    specs = [
        NodeSpec(
            f"cam{number}",
            PROFILES[camera],
            SimulatedClock(rng.randrange(-HOURS_NS, HOURS_NS), rng.gauss(0.0, SKEW_PPM)),
            PAPER_LINK,
            tolerance_ns=None,
        )
        for number in range(CAMERAS)
    ]
    rig = VirtualRig(specs, seed=seed, stagger=stagger)
    if not rig.run_until(rig.all_usable, limit_ns=READY_LIMIT_NS):
        raise RuntimeError(f"a rig of {camera} cameras, seed {seed}, is not ready after 200 s")
    ready_s = rig.now_true_ns / S
    rig.run_for(SETTLE_NS)
    burst = rig.trigger(frames=FRAMES)
    rig.run_for(BURST_NS)
    frames = [
        (pick.frame.start_true_ns, burst.instants_ns[pick.instant] + node.client.delay_ns)
        for node in rig.nodes.values()
        for pick in node.bursts[burst.number].frames
    ]
    times_ns = sorted(true_ns for true_ns, _ in frames)
    steps_ms = [(after - before) / 1e6 for before, after in pairwise(times_ns)]
    return ready_s, [abs(true_ns - due_ns) / 1000 for true_ns, due_ns in frames], steps_ms


def measure(cameras: list[str], seeds: int) -> Report:
    """Return a row for each kind of camera and order: all frames of all seeds."""
    rows: list[dict[str, Any]] = []
    for camera in cameras:
        for order, stagger in (("in step", None), ("staggered", Stagger())):
            trials = [trial(camera, seed, stagger) for seed in range(seeds)]
            ready_s = [one[0] for one in trials]
            errors_us = [error for one in trials for error in one[1]]
            steps_ms = sorted(step for one in trials for step in one[2])
            rows.append(
                {
                    "camera": camera,
                    "order": order,
                    "ready_s": sum(ready_s) / seeds,
                    "ready_max_s": max(ready_s),
                    "mean_us": sum(errors_us) / len(errors_us),
                    "max_us": max(errors_us),
                    "step_ms": None if stagger is None else steps_ms[len(steps_ms) // 2],
                    "frames": len(errors_us),
                }
            )
    return {"kind": "simulated", "seeds": seeds, "rigs": rows}


def main() -> None:
    """Measure and print."""
    parser = new_parser(__doc__)
    parser.add_argument("--camera", action="append", choices=[*PROFILES], help="kind of camera; repeatable")
    parser.add_argument("--seeds", type=int, default=5, help="rigs of each kind (5)")
    options = parser.parse_args()
    report = measure(options.camera or ["pi", "phone-a", "webcam"], options.seeds)
    print_report(report, lambda found: print_rows(found["rigs"], COLUMNS), as_json=options.json)


if __name__ == "__main__":
    main()
