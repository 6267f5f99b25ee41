"""Motion of a camera during a recording, measured from the static parts of its images."""

from dataclasses import dataclass

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.common.image_matching import track_there_and_back
from reconstruction.session.conditions import evenly_spaced
from reconstruction.session.dataset import Dataset
from reconstruction.session.moving_pixels import SHAKE_PX

GRID = (8, 6)
"""Cells across and down; each counts once, so that a highly textured object does not dominate."""
CELL_POINTS = 6
MIN_CELLS = 8
"""Minimum number of cells in which points can be tracked; with fewer the motion is unknown."""
PAIRS = 4
"""Number of image pairs that are compared."""
APART_NS = 500_000_000
"""Minimum time between the images of a pair; half the burst if that is shorter."""
MIN_STILL = 0.25
"""Minimum static fraction of the image; below it the camera moves, or moving objects fill its view."""
SIDE_PX = 640
"""Longer side to which larger images are reduced."""
WINDOW_PX = 15


@dataclass(frozen=True)
class CameraMotion:
    """Motion of a camera's image: `still_fraction` of it is static; its median motion is `px` in `ms`."""

    still_fraction: float
    px: float
    ms: float

    @property
    def moves(self) -> bool:
        """Whether the camera moved, or nearly everything in its view did, which looks the same."""
        return self.still_fraction < MIN_STILL


def measure_camera_motion(dataset: Dataset, camera: str) -> CameraMotion | None:
    """Track points between some of a camera's images; None if too few can be tracked."""
    times = [dataset.instants_ns[k] for k in dataset.instants(camera)]
    if len(times) < 2:
        return None
    # Half the burst shows slow motion; if nothing can be tracked over it, neighbouring images may do.
    for apart_ns in (min(APART_NS, (times[-1] - times[0]) // 2), 1):
        found = _follow_pairs(dataset, camera, max(1, apart_ns))
        if found:
            return CameraMotion(*(float(np.median(values)) for values in zip(*found, strict=True)))
    return None


def _follow_pairs(dataset: Dataset, camera: str, apart_ns: int) -> list[tuple[float, float, float]]:
    """Return static fraction, median motion (px) and time (ms) of image pairs at least `apart_ns` apart."""
    there, times = dataset.instants(camera), dataset.instants_ns
    later = {k: next((j for j in there if times[j] - times[k] >= apart_ns), None) for k in there}
    pairs = [(k, j) for k, j in later.items() if j is not None]
    found = []
    for before, after in evenly_spaced(pairs, PAIRS):
        moved = _cell_motions(dataset.grey(camera, before), dataset.grey(camera, after))
        if len(moved) >= MIN_CELLS:
            ms = (times[after] - times[before]) / 1e6
            found.append((float((moved < SHAKE_PX).mean()), float(np.median(moved)), ms))
    return found


def _cell_motions(before: Array, after: Array) -> Array:
    """Return the median motion (n,), px, of each `GRID` cell in which points can be tracked."""
    scale = min(1.0, SIDE_PX / max(before.shape))
    if scale < 1:
        size = {"fx": scale, "fy": scale, "interpolation": cv2.INTER_AREA}
        before, after = (cv2.resize(image, None, **size) for image in (before, after))
    height, width = before.shape
    across, down = width // GRID[0], height // GRID[1]
    corners, cells = [], []
    for cell in range(GRID[0] * GRID[1]):
        left, top = cell % GRID[0] * across, cell // GRID[0] * down
        part = np.ascontiguousarray(before[top : top + down, left : left + across])
        some = cv2.goodFeaturesToTrack(part, CELL_POINTS, 0.1, 5)
        if some is not None:
            corners.append(some.reshape(-1, 2) + np.array([left, top], np.float32))
            cells += [cell] * len(some)
    if not corners:
        return np.zeros(0)
    start = np.concatenate(corners)
    there, drift = track_there_and_back(before, after, start, WINDOW_PX)
    sure = drift < SHAKE_PX / 2
    lengths = np.linalg.norm(there - start, axis=1) / scale
    place = np.array(cells)
    ours = [lengths[sure & (place == cell)] for cell in np.unique(place)]
    return np.array([np.median(of) for of in ours if len(of) >= 2])
