"""What is said of takes whose lateness is known: certified, denied or not told, and whether error bars hold.

    python -m benchmarks.reconstruction.verdicts --seeds 3 --footage FOLDER --cache FOLDER

Painted pairs (a car in a street, boards, small and large movers, a thrown ball, a wall, a distant crowd),
on time, late by parts of a frame, with jitter, with a calibration that is off or guessed, with dropped or
repeated frames, at another rate; and, with --footage, a real ball. Simulated and real.
"""

import json
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reconstruction.verdict_takes import (
    Take,
    flat_takes,
    real_takes,
    real_unsteady_takes,
    session_of,
    takes,
    unsteady_takes,
)
from benchmarks.report import new_parser, print_rows, talk
from capture_app.common.errors import BadInputError
from reconstruction.compare.tolerance_study import measure_tolerance
from reconstruction.method.timing import Timing, measure_pair_timing
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene
from reconstruction.time_offsets.pair_offset import PairOffsets

SAME_FRAMES = 0.1
"""Fraction of a frame below which images may be called synchronized."""
COLUMNS = {
    "kind": ("takes", ""),
    "count": ("number", ""),
    "certified": ("certified", ""),
    "falsely_certified": ("falsely", ""),
    "same_frame": ("the same frame", ""),
    "falsely_same_frame": ("falsely", ""),
    "denied": ("denied", ""),
    "falsely_denied": ("falsely", ""),
    "untold": ("not told", ""),
    "told": ("error bars", ""),
    "held": ("held", ""),
    "changes": ("drops, rates", ""),
    "changes_told": ("told", ""),
    "placed": ("to 1 instant", ""),
    "ranged": ("in the range said", ""),
    "falsely_changed": ("falsely", ""),
}
RATE_FRAMES = 0.5
"""Change of a camera's delay over the take, in frames, from which its rate counts as different."""


def judge(take: Take, timing: Timing) -> dict[str, Any]:
    """Compare the judgement of a session with the truth."""
    late_ms, bar_ms, change = timing.late_ms, timing.uncertainty_ms, timing.change
    delays_ms = take.delays_ms()
    far_ms = float(np.abs(delays_ms).max()) + 2 * take.jitter_ms
    same_frame = timing.same_frame_ms is not None and not timing.synchronized
    steady = not take.jitter_ms and not take.slower and not take.wander_ms
    told = late_ms is not None and steady and (bool(change.steps) or not take.unsteady)
    jumps = [(k, 1) for k in take.drops] + [(k, -1) for k in take.doubles]
    changes = bool(jumps) or abs(take.slower) * take.frames > RATE_FRAMES
    exact = [(step.instant, step.instant, step.frames) for step in change.steps]
    rough = [(step.earliest, step.latest, step.frames) for step in change.steps]
    placed, ranged = (
        all(
            any(low - 1 <= k <= high + 1 and frames * sign > 0 for low, high, frames in said)
            for k, sign in jumps
        )
        for said in (exact, rough)
    )
    return {
        "kind": _group(take),
        "take": take.name,
        "true_ms": take.late_ms,
        "late_ms": late_ms,
        "bar_ms": bar_ms,
        "certified": timing.synchronized,
        "falsely_certified": timing.synchronized and far_ms > SAME_FRAMES * take.period_ms,
        "same_frame": same_frame,
        "falsely_same_frame": same_frame and far_ms > 0.5 * take.period_ms,
        "denied": timing.offset,
        "falsely_denied": timing.offset and take.truly_synchronized,
        "untold": not (timing.synchronized or timing.offset or same_frame),
        "told": told,
        "held": told and late_ms is not None and bar_ms is not None and abs(late_ms - take.late_ms) <= bar_ms,
        "changes": changes,
        "changes_told": changes and bool(change),
        "placed": changes and bool(change) and placed and bool(jumps) == bool(change.steps),
        "ranged": changes and bool(change) and ranged and bool(jumps) == bool(change.steps),
        "falsely_changed": bool(change) and not (jumps or take.slower),
        "change": change.describe("R", "L"),
        "reason": timing.reason,
    }


def _group(take: Take) -> str:
    guessed = ", guessed" * take.guess
    if take.drops or take.doubles:
        return f"{take.kind}{guessed}, drops"
    if take.slower:
        return f"{take.kind}{guessed}, rate"
    if take.jitter_ms or take.wander_ms:
        return f"{take.kind}{guessed}, jitter"
    if take.late_ms:
        return f"{take.kind}{guessed}, late"
    if take.geometry_px:
        return f"{take.kind}{guessed}, geometry off"
    return take.kind + guessed


def measure(session: Path, take: Take, *, by_depth: bool) -> Timing:
    """Measure a session's timing by motion, and `by_depth` too; unknown if its calibration is refused."""
    try:
        if by_depth:
            timing = measure_tolerance(session, max_instants=4, max_offset_ms=2.2 * take.period_ms).timing
            assert timing is not None
            return timing
        scene = Scene(Dataset.open(session))
        first, second = scene.dataset.cameras
        return measure_pair_timing(PairOffsets(scene), (first, second))
    except BadInputError as error:
        return Timing(reference="", other="", reason=str(error))


def run(
    chosen: Iterable[Take], cache: Path, footage: Path | None, *, by_depth: bool = True
) -> list[dict[str, Any]]:
    """Judge the sessions one after the other."""
    rows = []
    for take in chosen:
        session = session_of(take, cache, footage)
        begun = time.process_time()
        timing = measure(session, take, by_depth=by_depth)
        row = judge(take, timing) | {"seconds": time.process_time() - begun}
        rows.append(row)
        said = [key for key in ("certified", "same_frame", "denied", "untold") if row[key]]
        wrong = [key for key in row if key.startswith("falsely") and row[key]]
        late = "" if row["late_ms"] is None else f"{row['late_ms']:+.2f} ± {row['bar_ms']:.2f}"
        odd = "" if row["held"] or not row["told"] else "MISSED"
        talk(f"{take.name}: {late} {' '.join(said)} {' '.join(wrong)} {odd} {row['reason']}")
    return rows


def table(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the counts of each kind, and of all."""
    found = []
    for kind in [*dict.fromkeys(row["kind"] for row in rows), ""]:
        its = [row for row in rows if kind in ("", row["kind"])]
        sums = {key: sum(row[key] for row in its) for key in list(COLUMNS)[2:]}
        found.append({"kind": kind or "all", "count": len(its)} | sums)
    return found


def _folder(text: str) -> Path:
    """Return a folder by its whole path, so that links to its files lead there from anywhere."""
    return Path(text).resolve()


def main() -> None:
    """Print a table, or with --json one object with every session."""
    parser = new_parser(__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="of each kind of painted take (3)")
    parser.add_argument("--footage", type=_folder, help="folder with ball_launch")
    parser.add_argument(
        "--every", type=int, default=1, help="starts of the real ball's parts are so far apart"
    )
    parser.add_argument("--part", type=int, default=1, help="judge only every PART-th take")
    parser.add_argument(
        "--unsteady", action="store_true", help="only takes with drops, other rates or wandering times"
    )
    parser.add_argument("--fast", action="store_true", help="by motion alone, in a third of the time")
    parser.add_argument("--guess", action="store_true", help="only takes whose calibration is guessed")
    parser.add_argument("--cache", type=Path, help="keeps what was painted")
    chosen = parser.parse_args()
    wanted = [] if chosen.unsteady else [*takes(chosen.seeds), *flat_takes(chosen.seeds)]
    wanted += unsteady_takes(chosen.seeds)
    if chosen.footage is not None:
        wanted += [] if chosen.unsteady else real_takes(chosen.every)
        wanted += real_unsteady_takes()
    with tempfile.TemporaryDirectory() as scratch:
        cache = chosen.cache or Path(scratch)
        wanted = [take for take in wanted if take.guess or not chosen.guess]
        rows = run(wanted[:: chosen.part], cache, chosen.footage, by_depth=not chosen.fast)
    if not chosen.json:
        print_rows(table(rows), COLUMNS)
    print(json.dumps({"verdicts": table(rows), "takes": rows} if chosen.json else {"verdicts": len(rows)}))


if __name__ == "__main__":
    main()
