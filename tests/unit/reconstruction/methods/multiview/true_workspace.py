"""What a matcher would leave behind whose every map were true: a stand-in where there is no GPU."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import View
from reconstruction.methods.multiview.colmap_workspace import write_workspace
from reconstruction.methods.multiview.input_images import undistort_image, undistort_nearest
from reconstruction.methods.multiview.matcher import image_colours, image_views
from reconstruction.methods.multiview.sweep_matcher import ViewDepth
from reconstruction.scene.dataset import Dataset


def write_true_workspace(folder: Path, session: Session, views: Mapping[str, View], instant: int) -> None:
    """COLMAP's dense workspace of an instant, with the true depth, seen head-on."""
    dataset = Dataset.open(session.folder)
    images, maps = {}, {}
    for name, view in views.items():
        truth = dataset.ground_truth(name, instant)
        assert truth is not None
        images[name] = undistort_image(name, instant, dataset.image(name, instant), view)
        facing = np.zeros((*truth[0].shape, 3), np.float32)
        facing[..., 2] = -1
        maps[name] = ViewDepth(undistort_nearest(view, truth[0]), facing)
    write_workspace(folder, image_views(images), image_colours(images), maps)
