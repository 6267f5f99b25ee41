"""Accuracy of the stereo path on a real pair with ground truth, beside OpenCV's matcher as documented.

    python -m benchmarks.reconstruction.stereo_motorcycle FOLDER

FOLDER holds the Middlebury 2014 Motorcycle pair (Scharstein et al. 2014) as motorcycle_left.png,
motorcycle_right.png and motorcycle_disp.npz (disparity, px). bad-2.0 is the share of all pixels with a true
disparity whose own is missing or more than 2 px wrong; `wrong` is that of the pixels that were given one.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from benchmarks.report import print_rows
from reconstruction.common.geometry import Array, View
from reconstruction.stereo.stereo_pair import StereoPair

DISPARITIES = 64
FOCAL = 700.0
"""Any value: the pair is rectified, and disparities are read back from the depth with the same one."""
RUNS = 3
COLUMNS = {
    "name": ("matcher", ""),
    "bad": ("bad-2.0", ".2%"),
    "given": ("given", ".1%"),
    "wrong": ("wrong", ".2%"),
    "seconds": ("seconds", ".2f"),
}


def documented(mode: int, block: int = 3) -> Callable[[Array, Array], Array]:
    """OpenCV's semi-global matcher with the settings of its sample stereo_match.py, on colour pictures."""
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=DISPARITIES,
        blockSize=block,
        P1=8 * 3 * block * block,
        P2=32 * 3 * block * block,
        disp12MaxDiff=1,
        preFilterCap=63,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=32,
        mode=mode,
    )
    return lambda left, right: matcher.compute(left, right).astype(np.float32) / 16


def ours(*, checked: bool) -> Callable[[Array, Array], Array]:
    """The stereo path of `reconstruct stereo`: what is left after its checks, or all matches."""

    def run(left: Array, right: Array) -> Array:
        height, width = left.shape[:2]
        matrix = np.array([[FOCAL, 0, (width - 1) / 2], [0, FOCAL, (height - 1) / 2], [0, 0, 1]])
        views = [
            View(width, height, matrix, np.zeros(5), np.eye(3), np.array([-x, 0.0, 0.0])) for x in (0.0, 1.0)
        ]
        pair = StereoPair(views[0], views[1], (0, DISPARITIES - 2))
        found = pair.compute_depth(*(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in (left, right)))
        depth = found.depth if checked else found.raw
        return np.where(depth > 0, FOCAL / np.maximum(depth, 1e-9), -1.0)

    return run


def main(folder: Path) -> None:
    """Print the table."""
    left, right = (cv2.imread(str(folder / f"motorcycle_{side}.png")) for side in ("left", "right"))
    truth = np.load(folder / "motorcycle_disp.npz")["arr_0"]
    if left is None or right is None:
        sys.exit(f"{folder} has no motorcycle_left.png and motorcycle_right.png")
    known = np.isfinite(truth) & (truth > 0)
    rows = []
    for name, run in {
        "simulshot, before its checks": ours(checked=False),
        "simulshot, after its checks": ours(checked=True),
        "OpenCV SGBM, documented, 5 directions": documented(cv2.STEREO_SGBM_MODE_SGBM),
        "OpenCV SGBM, documented, HH": documented(cv2.STEREO_SGBM_MODE_HH),
        "OpenCV SGBM, documented, HH, block 5": documented(cv2.STEREO_SGBM_MODE_HH, 5),
    }.items():
        times = []
        for _ in range(RUNS):
            began = time.perf_counter()
            found = run(left, right)
            times.append(time.perf_counter() - began)
        given = known & (found > 0)
        right_ones = given & (np.abs(found - truth) <= 2.0)
        bad = 1 - right_ones.sum() / known.sum()
        wrong = 1 - right_ones.sum() / given.sum()
        given_share = given.sum() / known.sum()
        rows.append({"name": name, "bad": bad, "given": given_share, "wrong": wrong, "seconds": min(times)})
    print_rows(rows, COLUMNS)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
