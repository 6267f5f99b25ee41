"""A rig's calibration by COLMAP's structure from motion over what stands still in a burst."""

import shutil
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.errors import BadInputError
from capture_app.session.format.calibration import Calibration, CameraCalibration
from reconstruction.common.geometry import Array, View
from reconstruction.common.image_files import write_image
from reconstruction.common.native_libraries import load_pycolmap
from reconstruction.session.dataset import Dataset

MAX_INSTANTS = 3
"""Instants that structure from motion uses: more add time, not geometry, where the rig stands still."""


def calibrate_from_images(
    dataset: Dataset, movers: Callable[[str, int], Array], instants: Sequence[int]
) -> Calibration:
    """Calibrate the rig by COLMAP from the burst's still content; the unit of length is arbitrary.

    The cameras form one rig and each instant is one frame of it; moving pixels are masked out.

    Raises:
        NotAvailableError: COLMAP is not installed here.
        BadInputError: it found no cameras.
    """
    pycolmap = load_pycolmap(
        "finding the cameras' positions from the images", hint=", or give it a calibration.json"
    )
    chosen = [instants[int(i)] for i in np.linspace(0, len(instants) - 1, min(MAX_INSTANTS, len(instants)))]
    with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
        root = Path(scratch)
        _write_images(dataset, movers, sorted(set(chosen)), root)
        rec = _solve(pycolmap, dataset.cameras, root)
    if rec is None:
        raise BadInputError(
            "no calibration in the session, and none can be found from its images",
            hint="the views need to overlap and show something with texture; or add a calibration.json",
        )
    found = _cameras(rec, dataset)
    if len(found) < 2:
        raise BadInputError("only one camera could be placed", hint="the views need to overlap more")
    return Calibration(
        cameras=found,
        unit="arbitrary",
        source=f"COLMAP {pycolmap.__version__}, {len(found)} of {len(dataset.cameras)} cameras from "
        f"{rec.num_points3D()} still points, {rec.compute_mean_reprojection_error():.2f} px",
    )


def _write_images(
    dataset: Dataset, movers: Callable[[str, int], Array], instants: Sequence[int], root: Path
) -> None:
    for camera in dataset.cameras:
        for folder in ("images", "masks"):
            (root / folder / camera).mkdir(parents=True)
        for k in instants:
            if dataset.has_image(camera, k):
                name = f"{camera}/{k:06d}.png"
                write_image(root / "images" / name, dataset.image(camera, k))
                still = np.where(movers(camera, k), 0, 255).astype(np.uint8)
                write_image(root / "masks" / f"{name}.png", still)


def _solve(pycolmap: Any, cameras: Sequence[str], root: Path) -> Any | None:
    database = root / "database.db"
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "SIMPLE_RADIAL"
    reader.mask_path = str(root / "masks")
    pycolmap.set_random_seed(0)
    pycolmap.extract_features(
        database,
        root / "images",
        camera_mode=pycolmap.CameraMode.PER_FOLDER,
        reader_options=reader,
        device=pycolmap.Device.cpu,
    )
    pycolmap.match_exhaustive(database, device=pycolmap.Device.cpu)
    plain = root / "plain.db"
    shutil.copy(database, plain)
    found = _map_rig(pycolmap, cameras, database, root)
    if found is None or found.num_reg_images() < 2:
        # Little depth in the scene can be too little for the global way; one image after the other is surer.
        (root / "plain").mkdir()
        options = pycolmap.IncrementalPipelineOptions(random_seed=0, multiple_models=False, min_model_size=2)
        found = _largest(pycolmap.incremental_mapping(plain, root / "images", root / "plain", options))
    return found


def _map_rig(pycolmap: Any, cameras: Sequence[str], database: Path, root: Path) -> Any | None:
    """The cameras as one rig of unknown geometry: only global mapping solves that."""
    sensors = [
        pycolmap.RigConfigCamera(image_prefix=f"{name}/", ref_sensor=name == cameras[0]) for name in cameras
    ]
    opened = pycolmap.Database.open(database)
    pycolmap.apply_rig_config([pycolmap.RigConfig(cameras=sensors)], opened)
    opened.close()
    pycolmap.calibrate_view_graph(database)
    (root / "rig").mkdir()
    options = pycolmap.GlobalPipelineOptions(random_seed=0, min_model_size=2)
    return _largest(pycolmap.global_mapping(database, root / "images", root / "rig", options))


def _largest(models: dict[int, Any]) -> Any | None:
    return max(models.values(), key=lambda model: model.num_reg_images(), default=None)


def _cameras(rec: Any, dataset: Dataset) -> dict[str, CameraCalibration]:
    found: dict[str, CameraCalibration] = {}
    placed = [image for image in rec.images.values() if image.has_pose]
    instants = [image.name.split("/")[1] for image in placed]
    fullest = max(sorted(set(instants)), key=instants.count)
    for image, instant in zip(placed, instants, strict=True):
        if instant != fullest:
            continue
        name = image.name.split("/")[0]
        matrix = np.asarray(image.cam_from_world().matrix())
        focal, cx, cy, radial = (float(value) for value in image.camera.params)
        # COLMAP's first pixel has its centre at (0.5, 0.5).
        intrinsics = np.array([[focal, 0, cx - 0.5], [0, focal, cy - 0.5], [0, 0, 1]])
        distortion = np.array([radial, 0, 0, 0, 0])
        view = View(*dataset.size(name), intrinsics, distortion, matrix[:, :3], matrix[:, 3])
        found[name] = view.to_calibration()
    return found
