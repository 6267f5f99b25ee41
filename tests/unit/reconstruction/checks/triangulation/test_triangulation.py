"""Points that COLMAP places under the rig's poses: on what moves many when synchronized, few when not."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from capture_app.session.reading.reader import Session
from reconstruction.checks.triangulation.triangulation_study import triangulate
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene as OpenScene
from tests.unit.reconstruction.conftest import VIEWS


def test_points_lie_where_the_scene_is(boards: Session, tmp_path: Path) -> None:
    found = triangulate(OpenScene(Dataset(boards)), {"left": 2, "right": 2})
    assert len(found.points) > 100
    assert np.median(found.errors) < 0.5
    assert set(found.camera) == {0, 1}
    seen = found.camera == 0
    view = VIEWS["left"]
    pixels = view.project(found.points[found.point[seen]] @ view.rotation.T + view.translation)
    assert np.median(np.abs(pixels - found.pixel[seen])) < 1
    # All boards face along z.
    z = found.points[:, 2]
    nearest = np.abs(z[:, None] / np.array([2.2, 2.6, 3.0, 3.4, 4.0]) - 1).min(1)
    assert np.median(nearest) < 0.01


def test_two_studies_that_begin_together_share_the_features_of_an_instant(
    boards: Session, tmp_path: Path
) -> None:
    features = OpenScene(Dataset(boards)).features
    with ThreadPoolExecutor(2) as pool:
        first, second = pool.map(features.at_rest, (2, 2))
    assert first is second
