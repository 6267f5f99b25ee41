"""How wrong offsets are that a blinking torch tells, beside doing nothing: takes of two rolling shutters.

    python -m benchmarks.time_offsets.light --trials 10

One camera is up to 15 ms later than its times say; readouts of 16 and 28 ms, tone curves of their own, mains'
flicker of 3 %, JPEG. Simulated pictures.
"""

import json
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.report import new_parser, print_rows, talk
from benchmarks.time_offsets.scene_light import scene_light
from reconstruction.session.dataset import Dataset
from reconstruction.time_offsets.camera_time import CameraTime
from reconstruction.time_offsets.lamp import measure_light_offsets
from tests.reconstruction.time_offsets.blinking import BlinkCamera, Lamp, blink_times, write_blinks

FIRST_ROWS_NS, SECOND_ROWS_NS = 33_000, 58_000
LATE_NS = 15e6
CASES = {
    "2 and 2 ms": (2.0, 2.0, 0.0),
    "10 and 10 ms": (10.0, 10.0, 0.0),
    "2 and 10 ms, row times 3 % wrong": (2.0, 10.0, 0.03),
}
COLUMNS = {
    "case": ("exposures", ""),
    "nothing_ms": ("doing nothing, ms", ".2f"),
    "mean_us": ("mean error, us", ".0f"),
    "worst_us": ("worst", ".0f"),
    "sd_us": ("its sd", ".0f"),
    "within": ("within 2 sd", ".0%"),
    "told": ("told", ".0%"),
}


def measure(root: Path, case: str, trial: int) -> tuple[float, CameraTime]:
    """The true lateness of the second camera, ms, and what the lamp told of it."""
    first_ms, second_ms, wrong = CASES[case]
    rng = np.random.default_rng(1000 + trial)
    late_ns = int(rng.uniform(-LATE_NS, LATE_NS))
    cameras = {
        "a": BlinkCamera(
            scene_light("cam00"),
            FIRST_ROWS_NS,
            round(first_ms * 1e6),
            period_share=rng.uniform(),
            told_row_time_ns=round(FIRST_ROWS_NS * (1 - wrong)),
        ),
        "b": BlinkCamera(
            scene_light("cam01"),
            SECOND_ROWS_NS,
            round(second_ms * 1e6),
            late_ns,
            period_share=rng.uniform(),
            gamma=1 / 1.9,
            s_curve=-0.1,
            quality=80,
            told_row_time_ns=round(SECOND_ROWS_NS * (1 + wrong)),
        ),
    }
    session = write_blinks(root, f"take-{trial}", cameras, Lamp(blink_times(rng)), seed=trial)
    found = measure_light_offsets(Dataset.open(session.folder), "a")["b"]
    return late_ns / 1e6, found


def main() -> None:
    """Print a table, then one line of JSON."""
    parser = new_parser(__doc__)
    parser.add_argument("--trials", type=int, default=10, help="of each case (10)")
    chosen = parser.parse_args()
    rows = []
    for case in CASES:
        with tempfile.TemporaryDirectory() as root:
            results = [measure(Path(root), case, trial) for trial in range(chosen.trials)]
        late = np.array([ms for ms, _ in results])
        told = [(ms, one.offset_ms, one.sd_ms) for ms, one in results if one.offset_ms is not None]
        errors = np.array([found - ms for ms, found, _ in told])
        sds = np.array([sd for *_, sd in told])
        rows.append(
            {
                "case": case,
                "nothing_ms": float(np.abs(late).mean()),
                "mean_us": float(np.abs(errors).mean() * 1e3),
                "worst_us": float(np.abs(errors).max() * 1e3),
                "sd_us": float(sds.mean() * 1e3),
                "within": float(np.mean(np.abs(errors) < 2 * sds)),
                "told": len(told) / len(results),
            }
        )
        talk(f"{case}: {rows[-1]['mean_us']:.0f} us")
    if not chosen.json:
        print_rows(rows, COLUMNS)
    print(json.dumps({"time_from_light": rows}))


if __name__ == "__main__":
    main()
