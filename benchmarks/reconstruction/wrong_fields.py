"""What is said of sessions whose cameras were calibrated with a wrong field of view.

    python -m benchmarks.reconstruction.wrong_fields                       3 scenes, 6 errors
    python -m benchmarks.reconstruction.wrong_fields jumper --error 20

Runs `reconstruct calibrate --field-of-view`, `compare` of a pair's depth and times, and `multiview --quick`,
as a user does, on sample sessions without their calibration. The first row of a scene is its own calibration.
A verdict is wrong if it denies the difference that the right lens shows, or shows another; a tolerance if it
is less than half of the right lens's or more than twice it; an expectation if it is more than 15 points above
the true fraction, at the depth's best scale. Simulated.
"""

import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from benchmarks.report import new_parser, print_report, print_rows, talk
from capture_app.session.format.manifest import CALIBRATION
from reconstruction import open_session
from reconstruction.scene.dataset import Dataset

SCENES = ("jumper", "crossing", "pinwheel")
ERRORS_PCT = (-40.0, -20.0, -5.0, 5.0, 20.0, 40.0)
INSTANT, WIDTH = 2, 320
MAX_TOO_SURE = 0.15
COLUMNS = {
    "scene": ("scene", ""),
    "given": ("given, degrees", ".1f"),
    "focal": ("focal length off", "+.1%"),
    "lenses": ("lenses", ""),
    "verdict": ("verdict", ""),
    "tolerance": ("tolerance, ms", ".1f"),
    "time": ("times", ""),
    "expected": ("expected", ".0%"),
    "true": ("true", ".0%"),
    "wrong": ("wrong", ""),
}


def reconstruct(*words: object) -> tuple[dict[str, Any], str]:
    """Return the JSON of a command, and what it said; the JSON is empty if it failed."""
    command = [sys.executable, "-m", "reconstruction.cli", *map(str, words), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return (json.loads(done.stdout) if done.returncode == 0 else {}), done.stderr


def true_fraction(session: Path, found: dict[str, Any], folder: Path) -> float | None:
    """Return the fraction of all pixels within 2 % of the true depth, at the best scale, over all cameras.

    None if there is no depth, or the session has no truth.
    """
    dataset, fractions = Dataset.open(session), []
    for view in found.get("views", ()):
        if (truth := dataset.ground_truth(view["camera"], INSTANT)) is None:
            return None
        depth = np.load(folder / view["depth"])["depth"]
        rows, columns = (
            ((np.arange(n) + 0.5) * m / n).astype(int)
            for n, m in zip(depth.shape, truth[0].shape, strict=True)
        )
        ratio = np.divide(truth[0][np.ix_(rows, columns)], depth, where=depth > 0, out=np.zeros(depth.shape))
        logs = np.log(ratio[ratio > 0])
        scales = np.arange(-0.5, 0.5, 0.005) + np.median(logs)
        best = max(int((np.abs(logs - scale) < 0.02).sum()) for scale in scales)
        fractions.append(best / (truth[0] > 0).sum() * truth[0].size / depth.size)
    return float(np.mean(fractions)) if fractions else None


def kind_of(words: str) -> str:
    """Return what a verdict decides."""
    for text, kind in (
        ("No clear difference", "no difference"),
        ("gives no verdict", "none"),
        ("is found for", "difference"),
        ("agree on for", "difference"),
    ):
        if text in words:
            return kind
    return words[:40] or "failed"


def time_kind(timings: list[dict[str, Any]]) -> str:
    """Return what is said of the cameras' times, which are equal in truth."""
    if any(timing["offset"] for timing in timings):
        return "late"
    return "together" if any(timing["synchronized"] for timing in timings) else "none"


def measure(scene: str, error_pct: float | None, scratch: Path, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the row of a scene with a field of view that is off by that; None = its own calibration.

    An earlier row with the same cameras is not measured again.
    """
    true = open_session(Path("sample_sessions") / scene).calibration()
    assert true is not None
    session = scratch / f"{scene}{error_pct}"
    shutil.copytree(Path("sample_sessions") / scene, session)
    row: dict[str, Any] = {"scene": scene, "given": None, "lenses": "right", "wrong": ""}
    if error_pct is not None:
        (session / CALIBRATION).unlink()
        lens = next(iter(true.cameras.values()))
        view_deg = 2 * math.degrees(math.atan(lens.width / 2 / lens.fx))
        row["given"] = given = round(view_deg * (1 + error_pct / 100), 1)
        made, said = reconstruct("calibrate", session, "--field-of-view", given, "--no-keep")
        if not made:
            return row | {"lenses": said.strip().splitlines()[-1][:70]}
        for sign, kind in (
            ("not known well", "not known"),
            ("known roughly", "roughly"),
            ("pictures say", "believed"),
        ):
            if sign in made["source"]:
                row["lenses"] = kind
                break
        else:
            row["lenses"] = "known"
        row["source"] = made["source"]
    found = open_session(session).calibration()
    assert found is not None
    offs = [
        found.cameras[name].fx / lens.fx - 1 for name, lens in true.cameras.items() if name in found.cameras
    ]
    row["focal"], row["cameras"] = max(offs, key=abs), msgspec.json.encode(found.cameras).decode()
    if (same := next((one for one in rows if one.get("cameras") == row["cameras"]), None)) is not None:
        return same | {key: row[key] for key in ("given", "lenses", "source")}
    compared, said = reconstruct("compare", session, "--study", "stereo", "--out", scratch / "compare")
    row["verdict_text"] = words = compared.get("verdict", said[-300:])
    row["verdict"] = kind_of(words)
    timings = [compared.get("timing"), *(compared.get("rig_timing") or {}).get("cameras", ())]
    row["time"] = time_kind([timing for timing in timings if timing])
    row["tolerance"] = (compared.get("tolerance") or {}).get("tolerable_offset_ms")
    folder = scratch / "depth"
    depth, said = reconstruct(
        "multiview", session, "--instant", INSTANT, "--width", WIDTH, "--quick", "--out", folder
    )
    row["expected"] = depth.get("expected_within_2pct")
    row["multiview_text"] = said[-600:]
    row["true"] = true_fraction(session, depth, folder)
    for one in ("compare", "depth"):
        shutil.rmtree(scratch / one, ignore_errors=True)
    talk(json.dumps(row))
    return row


def judge(rows: list[dict[str, Any]]) -> None:
    """Say in each row what contradicts the right lens's row of its scene."""
    for row in rows:
        right = next(one for one in rows if one["scene"] == row["scene"])
        wrong = [one for one in ("verdict", "time") if row.get(one) not in (None, "none", right[one])]
        tolerated, truly = row.get("tolerance"), right["tolerance"]
        if tolerated is not None and (truly is None or not 0.5 < tolerated / truly < 2):
            wrong.append("tolerance")
        if None not in (row.get("expected"), row["true"]) and row["expected"] > row["true"] + MAX_TOO_SURE:
            wrong.append("expected")
        row["wrong"] = ", ".join(wrong)


def main() -> None:
    """Print a table, or JSON."""
    parser = new_parser(__doc__)
    parser.add_argument("scenes", nargs="*", default=[*SCENES], help=f"of {', '.join(SCENES)} (all)")
    parser.add_argument(
        "--error", type=float, action="append", metavar="PERCENT", help="[default: -40 to 40]"
    )
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        # No calibration of an earlier run is adopted.
        os.environ["XDG_DATA_HOME"] = scratch
        rows = list[dict[str, Any]]()
        for scene in asked.scenes:
            for error in (None, *(asked.error or ERRORS_PCT)):
                rows.append(measure(scene, error, Path(scratch), rows))
    judge(rows)
    print_report({"rows": rows}, lambda report: print_rows(report["rows"], COLUMNS), as_json=asked.json)


if __name__ == "__main__":
    main()
