"""What `pinwheel` is for: one instant gives the cameras' poses, frames of different ones give wrong poses."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture_app.session.store import Session
from reconstruction.native import load_pycolmap

PINWHEEL = Path(__file__).resolve().parents[2] / "sample_sessions" / "pinwheel"


def rotation_errors_deg(instants: Sequence[int], folder: Path) -> list[float]:
    """Angles by which COLMAP's rotations of each pair of cameras are wrong; `instants` by camera."""
    session = Session.open(PINWHEEL)
    calibration = session.calibration()
    assert calibration is not None
    images = session.images_by_instant()
    pictures = folder / "pictures"
    pictures.mkdir(parents=True)
    for name, instant in zip(calibration.cameras, instants, strict=True):
        shutil.copy(session.image_file(images[instant][name]), pictures / f"{name}.jpg")
    model = _mapped(folder / "database.db", pictures, next(iter(calibration.cameras.values())))
    found = {image.name[:-4]: image.cam_from_world().rotation.matrix() for image in model.images.values()}
    true = {name: np.array(camera.rotation) for name, camera in calibration.cameras.items()}
    assert len(found) >= 2
    names = sorted(found)
    return [
        _angle_deg(found[a] @ found[b].T @ (true[a] @ true[b].T).T)
        for number, a in enumerate(names)
        for b in names[number + 1 :]
    ]


def _mapped(database: Path, pictures: Path, camera: Any) -> Any:
    pycolmap: Any = load_pycolmap("mapping")
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "PINHOLE"
    reader.camera_params = f"{camera.fx},{camera.fy},{camera.cx + 0.5},{camera.cy + 0.5}"
    single = pycolmap.CameraMode.SINGLE
    pycolmap.extract_features(database, pictures, camera_mode=single, reader_options=reader)
    pycolmap.match_exhaustive(database)
    options = pycolmap.IncrementalPipelineOptions()
    options.ba_refine_focal_length = options.ba_refine_extra_params = False
    options.min_model_size = 2
    models = pycolmap.incremental_mapping(database, pictures, database.parent, options)
    assert models
    return max(models.values(), key=lambda one: one.num_reg_images())


def _angle_deg(rotation: Any) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))


@pytest.mark.slow
def test_poses_of_one_instant_are_right_and_of_different_ones_wrong(tmp_path: Path) -> None:
    together = rotation_errors_deg([2, 2, 2, 2, 2], tmp_path / "together")
    apart = rotation_errors_deg([2, 4, 0, 3, 1], tmp_path / "apart")
    assert len(together) == 10
    assert max(together) < 0.5
    assert max(apart) > 10
