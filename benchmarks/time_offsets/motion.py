"""How wrong offsets are that a second of motion tells, beside doing nothing: takes of two rolling shutters.

    python -m benchmarks.time_offsets.motion --trials 5

The jumping child, rows of 30 and 55 us, exposures of 4 and 8 ms, JPEG 90; one is late by up to 33 ms.
With the scene's calibration and, with --still, with what the pictures tell of the cameras. Simulated.
"""

import json
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.report import new_parser, print_rows, talk
from benchmarks.time_offsets.rendered_motion import Shutter, Take, write_take
from reconstruction.time_offsets.session_offsets import measure_times

PAIRS = (
    ("cam00", "cam01"),
    ("cam04", "cam05"),
    ("cam00", "cam06"),
    ("cam01", "cam04"),
    ("cam06", "cam05"),
)
OFFSETS = 5
MOST_LATE_MS = 33.0
CYCLE_S = 97.5
COLUMNS = {
    "trial": ("trial", ""),
    "late_ms": ("doing nothing, ms", "+.2f"),
    "error_us": ("error, us", "+.0f"),
    "sd_us": ("its sd", ".0f"),
    "seconds": ("s", ".0f"),
}


def make_take(trial: int) -> tuple[Take, float]:
    """What is shown, and by how much the second camera is late, ms."""
    rng = np.random.default_rng(trial)
    late_ms = float(MOST_LATE_MS * (2 * (trial % OFFSETS + rng.uniform()) / OFFSETS - 1))
    first, second = PAIRS[trial // OFFSETS % len(PAIRS)]
    start_ns = int(rng.uniform(0, CYCLE_S) * 1e9)
    cameras = {
        "a": Shutter(first, 30_000, 4_000_000),
        "b": Shutter(second, 55_000, 8_000_000, round(late_ms * 1e6)),
    }
    return Take(cameras, start_ns), late_ms


def main() -> None:
    """Print a table, then one line of JSON."""
    parser = new_parser(__doc__)
    parser.add_argument("--trials", type=int, default=5, help="(5)")
    parser.add_argument("--still", action="store_true", help="without a calibration")
    chosen = parser.parse_args()
    rows = []
    for trial in range(chosen.trials):
        take, late_ms = make_take(trial)
        begun = time.process_time()
        with tempfile.TemporaryDirectory() as root:
            session = write_take(Path(root), "take", take, calibrated=not chosen.still)
            found = measure_times(session.folder, "a").cameras["b"]
        row: dict[str, object] = {"trial": trial, "late_ms": late_ms, "seconds": time.process_time() - begun}
        if found.offset_ms is not None and found.sd_ms is not None:
            row |= {"error_us": (found.offset_ms - late_ms) * 1e3, "sd_us": found.sd_ms * 1e3}
        rows.append(row)
        talk(f"{trial}: {row.get('error_us')} us")
    told = [row for row in rows if "error_us" in row]
    errors = np.array([row["error_us"] for row in told], float)
    within = np.abs(errors) < 2 * np.array([row["sd_us"] for row in told], float)
    if not chosen.json:
        print_rows(rows, COLUMNS)
    summary = {
        "told": len(told),
        "of": len(rows),
        "rms_us": float(np.sqrt(np.mean(errors**2))),
        "worst_us": float(np.abs(errors).max()),
        "within_2sd": float(within.mean()),
    }
    print(json.dumps({"time_from_motion": summary | {"trials": rows}}))


if __name__ == "__main__":
    main()
