"""Joints of a drawn figure whose cameras are in step, late, staggered, or of unequal rates. Simulated.

The figure walks, runs and throws (hands to 10 m/s); joints in images have 3 px of noise. Each arrangement is
located by each frame's own time (interpolated), and by the nearest frames as other programs pair them. An
error is that of all joints, and of the hands; a bar is the 95 % error that the product states.
"""

from collections.abc import Sequence

import numpy as np

from benchmarks.people.figure import JOINTS, Floats, moving, ring, seen_by
from benchmarks.report import Columns, Report, new_parser, print_report, print_rows
from reconstruction.methods.people.people_run import PeopleFinder
from reconstruction.methods.people.skeletons import SKELETONS

SECONDS, MARGIN_S = 3.0, 0.2
HANDS = [JOINTS.index(name) for name in ("left_wrist", "right_wrist", "right_index", "left_index")]
MOTIONS = ("walk", "run", "throw")
ARRANGEMENTS = (
    "synced",
    "66 ms",
    "staggered",
    "24 with 60/s",
    "half a frame",
    "30, half a frame",
    "clocks 1 ms",
)
COLUMNS: Columns = {
    "cameras": ("cameras", "d"),
    "arrangement": ("arrangement", ""),
    "by": ("by", ""),
    "mean": ("mean, mm", ".1f"),
    "hands": ("hands, mm", ".1f"),
    "times_synced": ("of synced", ".2f"),
    "in_bars": ("in 95 % bars", ".1%"),
    "known": ("known", ".1%"),
}


def arrangement(kind: str, cameras: int) -> list[tuple[Floats, float, float]]:
    """Return the times of each camera's frames, their error, and by how much they are late unnoticed, s."""
    step = 1 / 60
    base = np.arange(0, SECONDS, step)
    slower = np.arange(0, SECONDS, 1 / 24)
    times = {
        "staggered": [base + step * k / cameras for k in range(cameras)],
        "24 with 60/s": [slower if k % 2 else base for k in range(cameras)],
        "half a frame": [base + step / 2 * (k % 2) for k in range(cameras)],
        "30, half a frame": [np.arange(0, SECONDS, 1 / 30) + (k % 2) / 60 for k in range(cameras)],
    }.get(kind, [base] * cameras)
    late = [0.066 * (k % 2) if kind == "66 ms" else 0.0 for k in range(cameras)]
    error = 0.001 if kind == "clocks 1 ms" else 0.0
    return [(one, error, late_by) for one, late_by in zip(times, late, strict=True)]


def measure(kind: str, motion_kind: str, cameras: int, seed: int) -> dict[str, dict[str, float]]:
    """Return the errors, mm, and the coverage of the stated ones, of one take: interpolated and nearest."""
    rng = np.random.default_rng(seed)
    motion = moving(motion_kind, phase=float(rng.uniform(0, 1.5)), heading=float(rng.uniform(0, 6.28)))
    taken = zip(ring(cameras, 90 if cameras == 2 else 180), arrangement(kind, cameras), strict=True)
    frames = {
        f"cam{k:02d}": seen_by(view, [motion], times, rng, time_error_s=error, late_s=late)
        for k, (view, (times, error, late)) in enumerate(taken)
    }
    slowest = max(float(np.diff(one.frame_s).max()) for one in frames.values())
    finder = PeopleFinder(frames, SKELETONS["blazepose"], slowest)
    times = np.arange(MARGIN_S, SECONDS - MARGIN_S, 1 / 60)
    measured = dict[str, dict[str, float]]()
    for by in ("time", "nearest"):
        (person, *others) = finder.at(times, nearest=by == "nearest").people
        if others:
            raise RuntimeError("one figure became several")
        apart = np.linalg.norm(person.positions - motion(times), axis=2) * 1e3
        known = np.isfinite(apart)
        measured[by] = {
            "mean": float(apart[known].mean()),
            "hands": float(np.nanmean(apart[:, HANDS])),
            "in_bars": float((apart[known] <= person.error[known] * 1e3).mean()),
            "known": float(known.mean()),
        }
    return measured


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the errors of all arrangements."""
    parser = new_parser(__doc__)
    parser.add_argument("--seeds", type=int, default=2, help="takes of each motion (2)")
    parser.add_argument(
        "--cameras", type=int, nargs="*", default=[2, 4, 8], help="numbers of cameras (2 4 8)"
    )
    parser.add_argument("--motions", nargs="*", default=MOTIONS, help="walk, run, throw")
    options = parser.parse_args(arguments)
    rows = list[dict[str, object]]()
    for cameras in options.cameras:
        synced = 0.0
        for kind in ARRANGEMENTS:
            runs = [
                measure(kind, motion, cameras, seed)
                for motion in options.motions
                for seed in range(options.seeds)
            ]
            for by in ("time", "nearest"):
                mean = {key: float(np.mean([run[by][key] for run in runs])) for key in runs[0][by]}
                synced = synced or mean["mean"]
                row = {
                    "cameras": cameras,
                    "arrangement": kind,
                    "by": by,
                    "times_synced": mean["mean"] / synced,
                }
                rows.append({**row, **mean})
    report: Report = {"kind": "simulated", "seeds": options.seeds, "rows": rows}
    print_report(report, lambda of: print_rows(of["rows"], COLUMNS), as_json=options.json)


if __name__ == "__main__":
    main()
