"""Wrong pixels of rectified pairs with true disparities, beside two modes of OpenCV's matcher as documented.

    python -m benchmarks.reconstruction.stereo_pairs            Motorcycle (shared/), and rendered pairs
    python -m benchmarks.reconstruction.stereo_pairs FOLDER     other pairs, laid out as Middlebury's

Rooms with a truth are at vision.middlebury.edu/stereo/data and www.eth3d.net, streets at www.cvlibs.net
(KITTI 2012: copy image_0, image_1 and disp_noc of one pair to im0.png, im1.png and disp0.png).

bad-2.0 is the share of all pixels with a true disparity whose own is missing or more than 2 px wrong;
`wrong` is that of the pixels that were given one. `simulshot` is its filled depth, `checked alone` what both
views agree on. OpenCV's matcher leaves out as many columns at the left as
it searches disparities. Simulshot widens its pictures by so many, so OpenCV gets them too: each row's first
pixel again and again. CPU time is that of all threads, the least of some runs; simulshot's is of all that it
does from two pictures to the depth. The last line is JSON.
"""

import json
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.reconstruction.rectified_pairs import RectifiedPair, read_pair, rendered_pairs
from benchmarks.report import new_parser, print_rows, talk
from capture_app.common.errors import ExitCode, SimulshotError
from reconstruction.common.geometry import Array, View
from reconstruction.methods.stereo.stereo_pair import FilledDepthMap, StereoPair, fill_holes

SHARED = Path(__file__).resolve().parents[3] / "shared" / "footage" / "stereo_ground_truth"
FOCAL = 700.0
"""Any value: the pair is rectified, and disparities are computed back from the depth with the same one."""
RUNS = 4
BLOCK = 3
COLUMNS = {
    "pair": ("pair", ""),
    "matcher": ("matcher", ""),
    "bad": ("bad-2.0", ".2%"),
    "given": ("given", ".1%"),
    "wrong": ("wrong", ".2%"),
    "median_px": ("median, px", ".3f"),
    "cpu_s": ("CPU s", ".3f"),
}
Row = dict[str, Any]


def sgbm(pair: RectifiedPair, mode: int) -> Array:
    """Run OpenCV's semi-global matcher with the settings of its sample stereo_match.py, on colour images."""
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=pair.count,
        blockSize=BLOCK,
        P1=8 * 3 * BLOCK * BLOCK,
        P2=32 * 3 * BLOCK * BLOCK,
        disp12MaxDiff=1,
        preFilterCap=63,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=32,
        mode=mode,
    )
    widened = (
        cv2.copyMakeBorder(picture, 0, 0, pair.count, 0, cv2.BORDER_REPLICATE)
        for picture in (pair.left, pair.right)
    )
    found: Array = matcher.compute(*widened)[:, pair.count :].astype(np.float32) / 16
    return found


def ours(pair: RectifiedPair) -> FilledDepthMap:
    """Run the stereo path of `reconstruct stereo` and `compare`, from its start."""
    height, width = pair.left.shape[:2]
    matrix = np.array([[FOCAL, 0, (width - 1) / 2], [0, FOCAL, (height - 1) / 2], [0, 0, 1]])
    views = [
        View(width, height, matrix, np.zeros(5), np.eye(3), np.array([-x, 0.0, 0.0])) for x in (0.0, 1.0)
    ]
    matcher = StereoPair(views[0], views[1], (0, pair.count - 2))
    grey = (cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) for picture in (pair.left, pair.right))
    return matcher.compute_both(*grey)[1]


def disparity(depth: Array) -> Array:
    """Return the disparity (px, -1 = none) of a depth of ours."""
    return np.where(depth > 0, FOCAL / np.maximum(depth, 1e-9), -1.0)


def judge(found: Array, truth: Array) -> Row:
    """Return fractions of the pixels with a true disparity."""
    known = truth > 0
    given = known & (found > 0)
    right = given & (np.abs(found - truth) <= 2.0)
    return {
        "bad": 1 - right.sum() / known.sum(),
        "given": given.sum() / known.sum(),
        "wrong": 1 - right.sum() / max(given.sum(), 1),
        "median_px": float(np.median(np.abs(found - truth)[given])) if given.any() else None,
    }


def timed(run: Callable[[], Any]) -> tuple[Any, float]:
    """Return the function's result, and its minimum CPU seconds."""
    times = []
    for _ in range(RUNS):
        began = time.process_time()
        found = run()
        times.append(time.process_time() - began)
    return found, min(times)


def measure(pair: RectifiedPair) -> list[Row]:
    """Return a row for each matcher, `simulshot` first."""
    depth, own_s = timed(lambda: ours(pair))
    rows: list[Row] = [
        {"matcher": "simulshot", **judge(disparity(depth.filled), pair.truth), "cpu_s": own_s},
        {"matcher": "simulshot, checked alone", **judge(disparity(depth.depth), pair.truth)},
    ]
    for name, mode in (
        ("SGBM, 5 directions", cv2.STEREO_SGBM_MODE_SGBM),
        ("HH, 8 directions", cv2.STEREO_SGBM_MODE_HH),
    ):
        found, seconds = timed(partial(sgbm, pair, mode))
        # Separates the gain by better matching from the gain by filling.
        filled = fill_holes(np.where(found >= 0, found, np.nan).astype(np.float32))
        rows.append({"matcher": name, **judge(found, pair.truth), "cpu_s": seconds})
        rows.append({"matcher": f"{name}, filled as ours", **judge(filled, pair.truth)})
    return [{"pair": pair.name, **row} for row in rows]


def summary(rows: list[Row]) -> Row:
    """Return the JSON entry of one pair: fractions in %."""
    own, checked, five, filled, eight, eight_filled = rows
    return {
        "ours": round(100 * own["bad"], 2),
        "sgbm_padded": round(100 * five["bad"], 2),
        "cpu_ratio": round(own["cpu_s"] / five["cpu_s"], 2),
        "ours_checked": round(100 * checked["bad"], 2),
        "ours_checked_wrong_of_given": round(100 * checked["wrong"], 2),
        "sgbm_wrong_of_given": round(100 * five["wrong"], 2),
        "ours_checked_median_px": round(checked["median_px"], 3),
        "sgbm_median_px": round(five["median_px"], 3),
        "sgbm_filled_as_ours": round(100 * filled["bad"], 2),
        "hh_padded": round(100 * eight["bad"], 2),
        "hh_filled_as_ours": round(100 * eight_filled["bad"], 2),
    }


def main() -> int:
    """Print the table, then one line of JSON."""
    parser = new_parser(__doc__)
    parser.add_argument("folders", nargs="*", type=Path, help="pairs with a truth [default: Motorcycle]")
    parser.add_argument("--steps-a-px", type=float, help="how many of a truth's steps are 1 px, if not usual")
    parser.add_argument("--real-only", action="store_true", help="leave out the rendered pairs")
    chosen = parser.parse_args()
    if not chosen.folders and not SHARED.is_dir():
        talk(f"The Motorcycle pair is not at {SHARED}: give folders of pairs with a truth.")
        return ExitCode.NOT_AVAILABLE
    try:
        pairs = [read_pair(folder, chosen.steps_a_px) for folder in chosen.folders or [SHARED]]
        if not chosen.real_only:
            pairs += rendered_pairs()
    except SimulshotError as error:
        talk(str(error))
        return error.exit_code
    rows = {pair.name: measure(pair) for pair in pairs}
    if not chosen.json:
        print_rows([row for one in rows.values() for row in one], COLUMNS)
    print(json.dumps({"pairs": {name: summary(one) for name, one in rows.items()}}))
    return ExitCode.OK


if __name__ == "__main__":
    sys.exit(main())
