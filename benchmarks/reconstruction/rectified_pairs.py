"""Rectified pairs with true disparities: folders in Middlebury's layout, and the package's own scenes."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.reconstruction.multiview_scenes import plain_pair
from capture_app.common.errors import BadInputError
from reconstruction.common.geometry import Array


@dataclass(frozen=True)
class RectifiedPair:
    """Two images (uint8 BGR) and the left one's true disparity (float32, px, 0 = unknown).

    `count` is the number of disparities searched from 0 on: a multiple of 16, as OpenCV's matcher requires.
    """

    name: str
    left: Array
    right: Array
    truth: Array
    count: int


LAYOUTS = (
    ("im0.png", "im1.png", ("disp0GT.pfm", "disp0.pfm"), 1.0),
    ("im0.png", "im1.png", ("disp0.png",), 256.0),
    ("im2.png", "im6.png", ("disp2.png",), 4.0),
    ("view1.png", "view5.png", ("disp1.png",), 3.0),
    ("*_left.png", "*_right.png", ("*_disp.npz",), 1.0),
)
"""Left, right, truth, and the number of steps of the truth per px.

Middlebury 2014 and 2021, KITTI, Middlebury 2003 at quarter size, 2005 and 2006 at a third, and Motorcycle
from scikit-image.
"""


def read_pair(folder: Path, steps_a_px: float | None = None) -> RectifiedPair:
    """Read the pair in a folder, by the names of its files.

    Raises:
        BadInputError: the folder has no such pair, or one of its files cannot be read.
    """
    for left, right, truths, usual in LAYOUTS:
        places = [_find(folder, (left,)), _find(folder, (right,)), _find(folder, truths)]
        if None in places:
            continue
        first, second, third = (place for place in places if place is not None)
        left_picture, right_picture = (cv2.imread(str(place), cv2.IMREAD_COLOR) for place in (first, second))
        try:
            truth = _read_truth(third)
        except (ValueError, OSError) as error:
            raise BadInputError(f"{third} cannot be read: {error}") from error
        if (
            truth is None
            or left_picture is None
            or right_picture is None
            or not left_picture.shape[:2] == right_picture.shape[:2] == truth.shape
        ):
            raise BadInputError(f"{folder}: the two pictures and {third.name} do not fit together")
        truth = np.where(np.isfinite(truth) & (truth > 0), truth / (steps_a_px or usual), 0)
        if not truth.any():
            raise BadInputError(f"{third} has no true disparity of any pixel")
        name = folder.resolve().name if left[0] != "*" else first.name.split("_")[0]
        count = _count(truth, folder / "calib.txt")
        return RectifiedPair(name, left_picture, right_picture, truth.astype(np.float32), count)
    known = ", ".join(f"{left} {right} {truths[0]}" for left, right, truths, _ in LAYOUTS)
    raise BadInputError(f"{folder} holds no pair with its true disparities", hint=f"one of: {known}")


def _find(folder: Path, names: tuple[str, ...]) -> Path | None:
    return next((path for name in names for path in sorted(folder.glob(name))), None)


def _read_truth(path: Path) -> Array | None:
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            return np.asarray(arrays[arrays.files[0]], np.float32)
    return _read_pfm(path) if path.suffix == ".pfm" else cv2.imread(str(path), cv2.IMREAD_UNCHANGED)


def _read_pfm(path: Path) -> Array:
    """Read a grey PFM. OpenCV applies the header's scale, which is meaningless in Middlebury's files."""
    kind, size, scale, pixels = path.read_bytes().split(b"\n", 3)
    width, height = (int(part) for part in size.split())
    if kind.strip() != b"Pf" or len(pixels) < 4 * width * height:
        raise ValueError(f"{path.name} is no grey PFM")
    order = "<f4" if float(scale) < 0 else ">f4"
    rows = np.frombuffer(pixels, order, width * height).reshape(height, width)
    return np.ascontiguousarray(rows[::-1], np.float32)


def _count(truth: Array, calibration: Path) -> int:
    most = float(truth.max())
    if calibration.is_file():
        entries = dict(line.split("=", 1) for line in calibration.read_text().splitlines() if "=" in line)
        most = float(entries.get("ndisp", most))
    return int(np.ceil((most + 1) / 16)) * 16


BASELINES_M = {"studio": 0.16, "crossing": 0.16, "pinwheel": 0.12}
AT_NS = 1_370_000_000
EXPOSURE_NS = 4_000_000


def rendered_pairs() -> list[RectifiedPair]:
    """Return a pair from each scene of the package, and one of weak texture and thin rods; all 640x480."""
    from capture_app.plugins.cameras.sim.rendering.scene import load

    pairs = []
    for name, baseline in BASELINES_M.items():
        scene = load(name)
        view = next(iter(scene.views.values()))
        for side, share in (("left", -0.5), ("right", 0.5)):
            centre = view.centre + share * baseline * view.rotation[0]
            scene.views[side] = replace(view, name=side, translation=-view.rotation @ centre)
        left, right = (
            scene.render(side, AT_NS, EXPOSURE_NS, 0, seed=seed)
            for seed, side in enumerate(("left", "right"), 1)
        )
        depth = scene.ground_truth("left", AT_NS, EXPOSURE_NS, 0)[0]
        pairs.append(_rendered(name, left, right, depth, view.focal_px * baseline))
    left, right, depth, focal_baseline = plain_pair()
    return [*pairs, _rendered("plain", left, right, depth, focal_baseline)]


def _rendered(name: str, left: Array, right: Array, depth: Array, focal_baseline: float) -> RectifiedPair:
    there = depth > 0
    truth = np.where(there, focal_baseline / np.where(there, depth, 1), 0).astype(np.float32)
    return RectifiedPair(f"{name} (simulated)", left, right, truth, int(np.ceil((truth.max() + 1) / 16)) * 16)
