"""Camera poses estimated from single instants, compared with the calibration."""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import numpy as np

from reconstruction.checks.poses.pose_check import PoseEstimation
from reconstruction.common import wording
from reconstruction.common.colmap import load_pycolmap
from reconstruction.common.geometry import Array, View, angle_deg
from reconstruction.common.image_files import FAST_PNG, write_image
from reconstruction.method.score import Score
from reconstruction.method.study_result import StudyResult
from reconstruction.method.tally import Measurements, Tally
from reconstruction.method.words import read_words
from reconstruction.scene.conditions import Condition, evenly_spaced
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.instant_choice import complete_instants, relative_offsets_ms

TOLERANCE_DEG = 2.0
HARMED = 0.1
LARGE_MOVING_FRACTION = 0.2
"""Moving fraction below which pose estimation rejects motion as outliers, even in delayed images."""
MAX_INSTANTS = 5
IMAGES = "images"
DATABASE = "database.db"
Pose = tuple[Array, Array]
"""Rotation 3x3 and translation (3,), camera from world."""
ImageKey = tuple[str, int]
"""A camera and an instant."""


@dataclass
class PoseFinder:
    """Pose estimation for any set of images with known intrinsics; features and matches are cached."""

    dataset: Dataset
    views: Mapping[str, View]
    folder: Path
    """Folder of COLMAP's database and of the images whose features are in it."""
    matched: set[tuple[ImageKey, ImageKey]] = field(default_factory=set)

    @cached_property
    def _colmap(self) -> Any:
        return load_pycolmap("finding the cameras' positions from the images")

    def find_poses(self, shown: Mapping[str, int]) -> dict[str, Pose]:
        """Return the poses of the largest model from these images; cameras without a pose are left out.

        Raises:
            NotAvailableError: COLMAP is not installed.
        """
        pictures = sorted(shown.items())
        for picture in pictures:
            self._extract(*picture)
        if new := [pair for pair in combinations(pictures, 2) if pair not in self.matched]:
            self._match(new)
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
        models = self._colmap.incremental_mapping(
            self.folder / DATABASE, self.folder / IMAGES, tempfile.mkdtemp(dir=self.folder), options
        )
        best = max(models.values(), key=lambda model: model.num_reg_images(), default=None)
        matrices = {
            image.name.split("/")[0]: np.asarray(image.cam_from_world().matrix())
            for image in (best.images.values() if best is not None else ())
            if image.has_pose
        }
        return {name: (matrix[:, :3], matrix[:, 3]) for name, matrix in matrices.items()}

    def _extract(self, camera: str, instant: int) -> None:
        """Detect an image's features, unless that was done."""
        path = self.folder / IMAGES / _name(camera, instant)
        if path.exists():
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        write_image(path, self.dataset.image(camera, instant), FAST_PNG)
        reader = self._colmap.ImageReaderOptions()
        reader.camera_model, reader.camera_params = _camera(self.views[camera])
        self._colmap.extract_features(
            self.folder / DATABASE,
            self.folder / IMAGES,
            image_names=[_name(camera, instant)],
            camera_mode=self._colmap.CameraMode.PER_FOLDER,
            reader_options=reader,
            device=self._colmap.Device.cpu,
        )

    def _match(self, pairs: Sequence[tuple[ImageKey, ImageKey]]) -> None:
        asked = self.folder / "pairs.txt"
        asked.write_text("".join(f"{_name(*a)} {_name(*b)}\n" for a, b in pairs))
        self._colmap.match_image_pairs(
            self.folder / DATABASE,
            pairing_options=self._colmap.ImportedPairingOptions(match_list_path=str(asked)),
            verification_options=self._colmap.TwoViewGeometryOptions(ransac={"random_seed": 0}),
            device=self._colmap.Device.cpu,
        )
        self.matched.update(pairs)


def _name(camera: str, instant: int) -> str:
    return f"{camera}/{instant:06d}.png"


def _camera(view: View) -> tuple[str, str]:
    """Return COLMAP's camera model for the view, and its parameters."""
    m = view.matrix
    # COLMAP's first pixel has its centre at (0.5, 0.5).
    numbers = [m[0, 0], m[1, 1], m[0, 2] + 0.5, m[1, 2] + 0.5]
    distortion = [*view.distortion, 0, 0, 0] if view.distortion.any() else []
    model = "FULL_OPENCV" if distortion else "PINHOLE"
    return model, ",".join(map(str, numbers + distortion))


def relative_pose_errors(poses: Mapping[str, Pose], true: Mapping[str, Pose]) -> list[tuple[float, float]]:
    """Return the errors of relative rotation and direction for each pair of estimated cameras, degrees.

    The world's origin, rotation and scale do not matter.
    """
    errors = []
    for a, b in combinations(sorted(poses), 2):
        rotation, axis = _relative(poses[a], poses[b])
        true_rotation, true_axis = _relative(true[a], true[b])
        cosine = np.clip((np.trace(rotation @ true_rotation.T) - 1) / 2, -1, 1)
        errors.append((float(np.degrees(np.arccos(cosine))), angle_deg(axis, true_axis)))
    return errors


def _relative(a: Pose, b: Pose) -> Pose:
    """Return the rotation from a's frame to b's, and b's position in a's frame."""
    rotation = b[0] @ a[0].T
    return rotation, a[1] - rotation.T @ b[1]


class PoseFacts(msgspec.Struct, frozen=True, kw_only=True):
    """Results that only the study of camera poses has."""

    degraded: bool
    """Whether delays degrade the poses."""
    tolerance_deg: float
    """Maximum errors of a correctly placed pair."""
    truth_source: str
    """Source of the reference poses."""


class PoseStudy(Score):
    """Camera poses of single instants, compared with the calibration."""

    text = read_words(__package__)
    needs_calibration = True
    packages = ("pycolmap",)
    Options = PoseEstimation

    finder: ClassVar[type[PoseFinder]] = PoseFinder

    @classmethod
    def placeholders(cls, found: StudyResult[PoseFacts]) -> dict[str, str]:
        """Return values for the names in braces; see `Score.placeholders`."""
        tolerance = wording.measured(found.facts.tolerance_deg, wording.DEGREES)
        return super().placeholders(found) | {"tolerance": tolerance}

    reason = ""
    """Why poses are estimated."""

    steps = 1

    def unasked(self) -> str:
        """Return why poses are not estimated; empty if requested or if much of the image moves."""
        asked = self.text.name in self.context.studies
        moves = f"{wording.percentage(self.known.moving_share, decimals=0)} of the picture moves"
        self.reason = "asked for" if asked else moves
        if not asked and self.known.moving_share < LARGE_MOVING_FRACTION:
            rejected = "which pose estimation rejects as outliers, in late pictures too"
            return f"{moves}, {rejected} (--study poses measures it anyway)"
        return ""

    def prepare(self) -> None:
        """Reject cameras whose poses cannot be compared.

        Raises:
            ValueError: fewer than three cameras are calibrated.
        """
        self.progress.step("camera poses from single instants")
        self.cameras = tuple(name for name in self.dataset.cameras if name in self.scene.known_views)
        if len(self.cameras) < 3:
            raise ValueError("poses of fewer than three cameras cannot be judged: the scale is unknown")

    def compare(self, condition: Condition, folder: Path | None = None) -> StudyResult[PoseFacts]:
        """Compare a condition, without pictures; see `Score.compare`."""
        tally = Tally()
        instants = complete_instants(
            self.dataset, condition, self.cameras[0], self.cameras, min_cameras=len(self.cameras)
        )
        with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
            finder = self.finder(self.dataset, self.scene.views, Path(scratch))
            for moment in evenly_spaced(instants, MAX_INSTANTS):
                measured = {side: self._measure(finder, shown) for side, shown in moment.by_condition.items()}
                tally.add(measured, {"instant": moment.instant})
        result = StudyResult(
            name=self.text.name,
            cameras=self.cameras,
            instants=tally.instants,
            offsets_ms=relative_offsets_ms(condition, self.dataset, self.cameras[0], self.cameras),
            reason=self.reason,
            measures=tally.measures,
            per_instant=tally.per_instant,
            facts=PoseFacts(degraded=False, tolerance_deg=TOLERANCE_DEG, truth_source=self.scene.source),
        )
        right = result.first_known("correct_pairs")
        degraded = right is not None and right[1] - right[2] > HARMED
        return msgspec.structs.replace(result, facts=msgspec.structs.replace(result.facts, degraded=degraded))

    def _measure(self, finder: PoseFinder, shown: dict[str, int]) -> Measurements:
        """Return the number of placed cameras, and both errors of each pair."""
        views = self.scene.views

        def make() -> tuple[int, list[tuple[float, float]]]:
            poses = finder.find_poses(shown)
            true = {name: (view.rotation, view.translation) for name, view in views.items()}
            return len(poses), relative_pose_errors(poses, true)

        placed, tracks = self.scene.once(("poses", *shown.items()), make)
        right = sum(max(error) <= TOLERANCE_DEG for error in tracks)
        errors = np.array(tracks, float).reshape(-1, 2)
        return Measurements(
            medians={"rotation_deg": errors[:, 0], "direction_deg": errors[:, 1]},
            means={
                "registered": np.array([float(placed)]),
                "correct_pairs": np.array([right / (len(shown) * (len(shown) - 1) // 2)]),
            },
        )
