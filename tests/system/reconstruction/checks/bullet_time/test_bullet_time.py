"""The bullet-time sweep: cameras in the order of their places, the subject held still, honest pictures."""

from pathlib import Path

import cv2
import numpy as np

from reconstruction.checks.bullet_time.bullet_time_study import (
    render_camera_sweep,
)
from reconstruction.method.comparison_results import CompareResult
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene as OpenScene
from tests.project import JUMPER


def test_the_animation_has_views_between_cameras_that_have_depth(tmp_path: Path) -> None:
    dataset = Dataset.open(JUMPER)
    sweep = render_camera_sweep(OpenScene(dataset), tmp_path, CompareResult(), 1)
    assert sweep is not None
    assert len(sweep.synced) == 5
    done, animation = cv2.imreadanimation(str(tmp_path / sweep.file))
    assert done
    # Five cameras and four views between them, there and back.
    assert len(animation.frames) == 2 * 9 - 2
    half = animation.frames[0].shape[1] // 2
    own, between = (animation.frames[number][40:, :half, :3].astype(float) for number in (0, 1))
    assert np.abs(own - between).mean() < 45
