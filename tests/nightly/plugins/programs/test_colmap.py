"""COLMAP's export is read back by COLMAP itself, which also maps a sample from its pictures alone."""

import json
from pathlib import Path
from typing import Any

import cv2  # noqa: F401 - before pycolmap
import numpy as np
import pytest

from capture_app.companions.exporting.export_session import export_session
from capture_app.session.reading.reader import Session
from tests.project import JUMPER

FARTHEST_M = 0.005


@pytest.mark.timeout(900)
def test_jumper_maps_without_being_told_the_rig(tmp_path: Path) -> None:
    if not JUMPER.is_dir():
        pytest.skip("sample_sessions/jumper is not rendered here")
    pycolmap = pytest.importorskip("pycolmap")
    out = tmp_path / "colmap"
    export_session(Session.open(JUMPER), "colmap", out)
    truth = pycolmap.Reconstruction(str(out / "sparse" / "0"))
    model = _map(out, tmp_path)
    assert model.num_reg_images() == len(truth.images) == 25
    assert (len(model.rigs), model.num_reg_frames()) == (1, 5)
    true_centres = {image.name: image.projection_center() for image in truth.images.values()}
    found = {image.name: image.projection_center() for image in model.images.values() if image.has_pose}
    names = sorted(true_centres)
    wanted = np.array([true_centres[name] for name in names])
    metres_from_model = pycolmap.estimate_sim3d(np.array([found[name] for name in names]), wanted)
    placed = np.array([metres_from_model * found[name] for name in names])
    assert np.linalg.norm(placed - wanted, axis=1).max() < FARTHEST_M


def _map(out: Path, folder: Path) -> Any:
    """Global mapping with the export's intrinsics and rig, but without the poses of the rig's cameras."""
    pycolmap = pytest.importorskip("pycolmap")
    pycolmap.set_random_seed(0)
    database_path = str(folder / "database.db")
    features = pycolmap.FeatureExtractionOptions()
    features.sift.max_num_features = 2000
    pycolmap.extract_features(
        database_path,
        str(out / "images"),
        camera_mode=pycolmap.CameraMode.PER_FOLDER,
        extraction_options=features,
    )
    config = json.loads((out / "rig_config.json").read_text())
    for camera in config[0]["cameras"]:
        camera.pop("cam_from_rig_rotation", None)
        camera.pop("cam_from_rig_translation", None)
    (folder / "rig.json").write_text(json.dumps(config))
    with pycolmap.Database.open(database_path) as database:
        pycolmap.apply_rig_config(pycolmap.read_rig_config(str(folder / "rig.json")), database)
    pycolmap.match_exhaustive(database_path)
    options = pycolmap.GlobalPipelineOptions()
    adjustment = options.mapper.bundle_adjustment
    adjustment.refine_focal_length = False
    adjustment.refine_principal_point = False
    adjustment.refine_extra_params = False
    (folder / "model").mkdir()
    models = pycolmap.global_mapping(database_path, str(out / "images"), str(folder / "model"), options)
    assert len(models) == 1
    return models[0]
