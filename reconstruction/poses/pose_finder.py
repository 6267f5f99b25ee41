"""Where the cameras stand, from the pictures of one instant alone by COLMAP, and how far off that is."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.common.geometry import Array, View, angle_deg
from reconstruction.common.image_files import FAST_PNG, write_image
from reconstruction.common.native_libraries import load_pycolmap
from reconstruction.session.dataset import Dataset

Pose = tuple[Array, Array]
"""Rotation 3x3 and translation (3,), camera from world."""
ImageKey = tuple[str, int]
"""A camera and an instant."""


class PoseFinder:
    """Poses of any set of pictures by known intrinsics; features and matches are made once, in a folder."""

    def __init__(self, dataset: Dataset, views: Mapping[str, View], folder: Path) -> None:
        """Raises NotAvailableError where COLMAP is not installed."""
        self._colmap: Any = load_pycolmap("finding the cameras' positions from the images")
        self._dataset = dataset
        self._views = views
        self._images = folder / "images"
        self._images.mkdir(parents=True)
        self._database = folder / "database.db"
        self._folder = folder
        self._extracted: set[ImageKey] = set()
        self._matched: set[tuple[ImageKey, ImageKey]] = set()
        self._models = 0

    def find_poses(self, shown: Mapping[str, int]) -> dict[str, Pose]:
        """The poses of the largest model that these pictures give; cameras without one are left out."""
        pictures = sorted(shown.items())
        self._extract(pictures)
        self._match(list(combinations(pictures, 2)))
        options = self._colmap.IncrementalPipelineOptions(
            random_seed=0,
            num_threads=1,
            multiple_models=True,
            min_model_size=2,
            image_names=[_name(*picture) for picture in pictures],
            ba_refine_focal_length=False,
            ba_refine_extra_params=False,
            ba_refine_principal_point=False,
        )
        self._models += 1
        target = self._folder / f"model{self._models}"
        target.mkdir()
        models = self._colmap.incremental_mapping(self._database, self._images, target, options)
        best = max(models.values(), key=lambda model: model.num_reg_images(), default=None)
        if best is None:
            return {}
        found = {}
        for image in best.images.values():
            if image.has_pose:
                matrix = np.asarray(image.cam_from_world().matrix())
                found[image.name.split("/")[0]] = matrix[:, :3], matrix[:, 3]
        return found

    def _extract(self, pictures: Iterable[ImageKey]) -> None:
        for camera, instant in pictures:
            if (camera, instant) in self._extracted:
                continue
            path = self._images / _name(camera, instant)
            path.parent.mkdir(exist_ok=True)
            write_image(path, self._dataset.image(camera, instant), FAST_PNG)
            reader = self._colmap.ImageReaderOptions()
            reader.camera_model, reader.camera_params = _camera(self._views[camera])
            self._colmap.extract_features(
                self._database,
                self._images,
                image_names=[_name(camera, instant)],
                camera_mode=self._colmap.CameraMode.PER_FOLDER,
                reader_options=reader,
                device=self._colmap.Device.cpu,
            )
            self._extracted.add((camera, instant))

    def _match(self, pairs: Sequence[tuple[ImageKey, ImageKey]]) -> None:
        new = [pair for pair in pairs if pair not in self._matched]
        if not new:
            return
        asked = self._folder / "pairs.txt"
        asked.write_text("".join(f"{_name(*a)} {_name(*b)}\n" for a, b in new))
        verification = self._colmap.TwoViewGeometryOptions()
        verification.ransac.random_seed = 0
        self._colmap.match_image_pairs(
            self._database,
            pairing_options=self._colmap.ImportedPairingOptions(match_list_path=str(asked)),
            verification_options=verification,
            device=self._colmap.Device.cpu,
        )
        self._matched.update(new)


def _name(camera: str, instant: int) -> str:
    return f"{camera}/{instant:06d}.png"


def _camera(view: View) -> tuple[str, str]:
    """COLMAP's name for the view's kind of camera, and its numbers."""
    m = view.matrix
    # COLMAP's first pixel has its centre at (0.5, 0.5).
    numbers = [m[0, 0], m[1, 1], m[0, 2] + 0.5, m[1, 2] + 0.5]
    if not view.distortion.any():
        return "PINHOLE", ",".join(map(str, numbers))
    return "FULL_OPENCV", ",".join(map(str, [*numbers, *view.distortion, 0, 0, 0]))


def relative_pose_errors(found: Mapping[str, Pose], true: Mapping[str, Pose]) -> list[tuple[float, float]]:
    """Errors of each two cameras that were found: of their rotation against each other, and of the
    direction from one to the other; degrees. The world's place, turn and scale do not matter."""
    errors = []
    for a, b in combinations(sorted(found), 2):
        (turn, way), (true_turn, true_way) = (_relative(poses[a], poses[b]) for poses in (found, true))
        cosine = (np.trace(turn @ true_turn.T) - 1) / 2
        errors.append((float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))), angle_deg(way, true_way)))
    return errors


def _relative(a: Pose, b: Pose) -> Pose:
    """Rotation from a's frame to b's, and where b stands in a's frame."""
    turn = b[0] @ a[0].T
    return turn, a[1] - turn.T @ b[1]
