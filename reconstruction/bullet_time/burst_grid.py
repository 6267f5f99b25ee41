"""The burst as a grid of small pictures: cameras by instants, the paper's space-time volume."""

from pathlib import Path

import cv2
import numpy as np

from reconstruction.common.image_files import save_picture
from reconstruction.scores.compare_results import BurstGrid
from reconstruction.session.dataset import Dataset
from reconstruction.session.frame_offset import evenly_spread

MAX_CAMERAS = 20
MAX_INSTANTS = 8
WIDTH_PX = 160


def render_burst_grid(dataset: Dataset, out: Path) -> BurstGrid:
    """Write the thumbnails into out/pictures; of a long burst, instants spread evenly over it."""
    count = len(dataset.instants_ns)
    instants = evenly_spread(range(count), MAX_INSTANTS)
    cameras = dataset.cameras[:MAX_CAMERAS]
    rows = []
    for camera in cameras:
        row = []
        for instant in instants:
            if not dataset.has_image(camera, instant):
                row.append("")
                continue
            image = dataset.image(camera, instant)
            scale = WIDTH_PX / image.shape[1]
            small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            row.append(save_picture(out, f"burst_{camera}_{instant:06d}.jpg", np.asarray(small)))
        rows.append(tuple(row))
    first = dataset.instants_ns[0]
    return BurstGrid(
        cameras=tuple(cameras),
        instants=tuple(instants),
        times_ms=tuple((dataset.instants_ns[k] - first) / 1e6 for k in instants),
        thumbnails=tuple(rows),
    )
