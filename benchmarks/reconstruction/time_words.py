"""What `reconstruct time` says of takes of which single images are off, beside the truth.

    python -m benchmarks.reconstruction.time_words --cache FOLDER

Forty painted takes of two cameras: steady, glitches, repeated images, jitter, a drop, another
rate. Simulated.
"""

import json
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.reconstruction.verdict_takes import Take, session_of, single_image_takes
from benchmarks.report import new_parser, print_rows, talk
from capture_app.common.errors import SimulshotError
from reconstruction.common.templates import render_lines
from reconstruction.time_offsets.session_offsets import measure_times

COLUMNS = {"kind": ("scene", ""), "truth": ("the right camera", ""), "said": ("said", "")}


def truth(take: Take) -> str:
    """Return what is true of a take, in words."""
    known = {
        "a frame late at": take.glitches,
        "repeats its image at": take.repeats,
        "a frame later from": take.drops,
        "late at half of its instants, ms": round(take.late_or_not_ms, 1),
        "jitters, ms (uniform, to either side)": 2 * take.jitter_ms,
        "its frames last longer, %": round(100 * take.slower, 2),
    }
    return "; ".join(f"{what} {value}" for what, value in known.items() if value) or "on time"


def judge(take: Take, cache: Path) -> dict[str, Any]:
    """Return the truth of a take and what is said of it."""
    row = {"kind": take.kind, "truth": truth(take)}
    try:
        result = measure_times(session_of(take, cache, None), "left")
    except SimulshotError as error:
        return row | {"said": str(error)}
    return row | {"said": "; ".join(render_lines("times.txt", "reconstruction.commands", result=result))}


def main() -> None:
    """Print a table, or with --json one object with every take."""
    parser = new_parser(__doc__)
    parser.add_argument("--part", type=int, default=1, help="judge only every PART-th take")
    parser.add_argument("--cache", type=Path, help="keeps what was painted")
    chosen = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for take in [*single_image_takes()][:: chosen.part]:
            rows.append(judge(take, chosen.cache or Path(scratch)))
            talk(f"{rows[-1]['kind']}: {rows[-1]['truth']}: {rows[-1]['said']}")
    if not chosen.json:
        print_rows(rows, COLUMNS)
    print(json.dumps({"takes": rows} if chosen.json else {"takes": len(rows)}))


if __name__ == "__main__":
    main()
