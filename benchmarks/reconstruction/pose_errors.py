"""Depth by the error of the cameras' poses, as `reconstruct multiview` computes it, and with --refine.

    python -m benchmarks.reconstruction.pose_errors              the sample session jumper, 2 draws each
    python -m benchmarks.reconstruction.pose_errors --session FOLDER --error 0.5
    python -m benchmarks.reconstruction.pose_errors --turned 1 --turned 4 --width 320 --quick --as-it-is

Each camera is turned by a random angle (standard deviation, px in its image), and with --moved moved by as
much at 3 m. With --turned, only that many cameras are, drawn by chance; "said" is what `multiview` warns of.
Images cannot show how wrong all distances between cameras are: refined depth is as wrong. Means
over all cameras. A session with ground truth; simulated.
"""

import argparse
import shutil
import tempfile
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np

from benchmarks.report import new_parser, print_report, print_rows, talk
from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.format.manifest import CALIBRATION
from reconstruction import Multiview, open_session

ERRORS_PX = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0)
SAMPLE, INSTANT = Path("sample_sessions/jumper"), 4
DISTANCE = 3.0
"""Distance, in the calibration's unit, at which a move counts like a turn."""
COLUMNS = {
    "error_px": ("error, px", "g"),
    "turned": ("cameras", "d"),
    "rest_px": ("misfit, px", ".2f"),
    "within_2pct": ("within 2 %", ".1%"),
    "expected": ("expected", ".1%"),
    "said": ("said", ""),
    "refined_px": ("refined: misfit", ".2f"),
    "refined_within_2pct": ("within 2 %", ".1%"),
    "refined_expected": ("expected", ".1%"),
}


def spoilt(
    calibration: Calibration, error_px: float, seed: int, distance: float, turned: int | None = None
) -> Calibration:
    """Return a calibration with each camera turned by that, and moved by as much at a distance.

    `turned`: only so many, drawn by chance.
    """
    rng = np.random.default_rng(seed)

    def wrong(camera: CameraCalibration) -> CameraCalibration:
        turn, move = rng.normal(0, error_px / camera.fx, (2, 3))
        rotation = cv2.Rodrigues(turn)[0] @ np.array(camera.rotation)
        translation = cv2.Rodrigues(turn)[0] @ np.array(camera.translation) + distance * move
        return msgspec.structs.replace(
            camera, rotation=tuple(map(tuple, rotation.tolist())), translation=tuple(translation.tolist())
        )

    cameras = {name: wrong(camera) for name, camera in calibration.cameras.items()}
    if turned is not None:
        kept = np.random.default_rng([seed, turned]).permutation([*cameras])[turned:]
        cameras |= {name: calibration.cameras[name] for name in kept}
    return msgspec.structs.replace(calibration, cameras=cameras)


def run(
    session: Path, error_px: float, seed: int, scratch: Path, turned: int | None, asked: argparse.Namespace
) -> dict[str, Any]:
    """Return the row of an error and a draw."""
    true = open_session(session).calibration()
    assert true is not None
    copy = scratch / f"{session.name}-{error_px:g}-{seed}-{turned}"
    shutil.copytree(session, copy)
    wrong = spoilt(true, error_px, seed, DISTANCE * asked.moved, turned)
    (copy / CALIBRATION).write_bytes(msgspec.json.encode(wrong))
    row: dict[str, Any] = {"error_px": error_px, "turned": len(true.cameras) if turned is None else turned}
    for prefix, refine in (("", False), *([] if asked.as_it_is else [("refined_", True)])):
        options = Multiview(
            instant=INSTANT, mesh=False, cloud=False, refine=refine, quick=asked.quick, width=asked.width
        )
        result = open_session(copy).multiview(options).result
        views = [view for view in result.views if view.within_2pct is not None]
        row[f"{prefix}within_2pct"] = float(np.mean([view.within_2pct for view in views]))
        row[f"{prefix}expected"] = float(np.mean([view.expected_within_2pct for view in views]))
        row[f"{prefix}px" if prefix else "rest_px"] = result.rest_error_px
        if not refine:
            row["said"] = "warned" if "warning" in result.basis else "-"
    talk(str(row))
    return row


def main() -> None:
    """Print a table, or JSON."""
    parser = new_parser(__doc__)
    parser.add_argument("--session", type=Path, default=SAMPLE, help=f"[default: {SAMPLE}]")
    parser.add_argument("--error", type=float, action="append", metavar="PX", help="[default: 0 to 4]")
    parser.add_argument("--draws", type=int, default=2, help="of each error [default: 2]")
    parser.add_argument("--moved", action="store_true", help="move the cameras too")
    parser.add_argument("--quick", action="store_true", help="as the command's")
    parser.add_argument("--turned", type=int, action="append", metavar="N", help="cameras [default: all]")
    parser.add_argument("--width", type=int, metavar="PX", help="as the command's")
    parser.add_argument("--as-it-is", action="store_true", help="not with --refine")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        rows = [
            run(asked.session, error_px, seed, Path(scratch), turned, asked)
            for error_px in asked.error or ERRORS_PX
            for turned in asked.turned or (None,)
            for seed in range(asked.draws if error_px else 1)
        ]
    print_report({"rows": rows}, lambda report: print_rows(report["rows"], COLUMNS), as_json=asked.json)


if __name__ == "__main__":
    main()
