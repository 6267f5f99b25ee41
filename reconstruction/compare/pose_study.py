"""The pose study of a comparison: where the cameras stand by single instants, and how far off that is."""

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any, Self

import msgspec
import numpy as np

from capture_app.console.terminal import Progress
from reconstruction.calibration.rig import Rig
from reconstruction.common.geometry import Array, View, angle_deg
from reconstruction.common.image_files import FAST_PNG, write_image
from reconstruction.common.native_libraries import library_versions, load_pycolmap
from reconstruction.compare.study import Study
from reconstruction.scores.study_result import StudyResult
from reconstruction.scores.tally import Measurements, Tally
from reconstruction.session.conditions import Condition, evenly_spread
from reconstruction.session.dataset import Dataset
from reconstruction.session.instants import ShownInstant, fullest_instants, relative_offsets_ms

TOLERANCE_DEG = 2.0
HARMED = 0.1
LARGE_MOVING_SHARE = 0.2
"""If less of the picture moves, pose estimation rejects it as outliers, in late pictures too."""
MAX_INSTANTS = 5
Pose = tuple[Array, Array]
"""Rotation 3x3 and translation (3,), camera from world."""
ImageKey = tuple[str, int]
"""A camera and an instant."""


class PoseFinder:
    """Poses of any set of pictures by known intrinsics; features and matches are made once, in a folder."""

    def __init__(self, dataset: Dataset, views: Mapping[str, View], folder: Path) -> None:
        self._dataset = dataset
        self._views = views
        self._images = folder / "images"
        self._database = folder / "database.db"
        self._folder = folder
        self._extracted: set[ImageKey] = set()
        self._matched: set[tuple[ImageKey, ImageKey]] = set()

    @cached_property
    def _colmap(self) -> Any:
        return load_pycolmap("finding the cameras' positions from the images")

    def find_poses(self, shown: Mapping[str, int]) -> dict[str, Pose]:
        """The poses of the largest model that these pictures give; cameras without one are left out.

        Raises:
            NotAvailableError: COLMAP is not installed.
        """
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
        target = tempfile.mkdtemp(dir=self._folder)
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
            path.parent.mkdir(parents=True, exist_ok=True)
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


class PoseStudy(Study):
    """Camera poses of single instants, compared with the calibration."""

    name = "poses"
    steps = 1

    def __init__(
        self,
        rig: Rig,
        reason: str = "",
        max_instants: int = MAX_INSTANTS,
        finder: type[PoseFinder] = PoseFinder,
    ) -> None:
        """`reason` says why poses are estimated; `finder` estimates them."""
        super().__init__(rig)
        self.reason = reason
        self.max_instants = max_instants
        self.finder = finder
        self.cameras: tuple[str, ...] = ()

    def for_session(self, rig: Rig) -> Self:
        """Poses of another session's cameras."""
        return type(self)(rig, self.reason, self.max_instants, self.finder)

    def prepare(self, middle: int, progress: Progress) -> None:
        """Refuse cameras whose poses cannot be compared.

        Raises:
            ValueError: fewer than three cameras are calibrated.
        """
        progress.step("camera poses from single instants")
        self.cameras = tuple(name for name in self.dataset.cameras if name in self.rig.views)
        if not self.cameras:
            raise ValueError("the cameras have no calibration to compare poses with")
        if len(self.cameras) < 3:
            raise ValueError("poses of fewer than three cameras cannot be judged: the scale is unknown")

    def compare(self, condition: Condition, progress: Progress, folder: Path | None = None) -> StudyResult:
        """As `Study.compare`; there are no pictures."""
        instants = self._instants(condition)
        tally = Tally()
        with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
            finder = self.finder(self.dataset, self.rig.views, Path(scratch))
            for one in instants:
                sides = one.sides.items()
                measured = {side: self._measure(finder, pictures) for side, pictures in sides}
                tally.add(measured, {"instant": one.instant})
        found = StudyResult(
            name=self.name,
            cameras=self.cameras,
            instants=tally.instants,
            offsets_ms=relative_offsets_ms(condition, self.dataset, self.cameras[0], self.cameras),
            reason=self.reason,
            measures=tally.measures,
            per_instant=tally.per_instant,
            facts={"tolerance_deg": TOLERANCE_DEG, "truth_source": self.rig.source},
        )
        right = found.first_known("correct_pairs")
        harmed = right is not None and right[1] - right[2] > HARMED
        return msgspec.structs.replace(found, facts={"degraded": harmed, **found.facts})

    def _instants(self, condition: Condition) -> list[ShownInstant]:
        """The instants at which every camera has its pictures, thinned."""
        cameras = self.cameras
        found = fullest_instants(self.dataset, condition, cameras[0], cameras, fewest=len(cameras))
        return evenly_spread(found, self.max_instants)

    def _measure(self, finder: PoseFinder, shown: dict[str, int]) -> Measurements:
        """How many cameras were placed, and both errors of each pair of them."""
        views = self.rig.views

        def make() -> tuple[int, list[tuple[float, float]]]:
            poses = finder.find_poses(shown)
            true = {name: (view.rotation, view.translation) for name, view in views.items()}
            return len(poses), relative_pose_errors(poses, true)

        placed, found = self.rig.stages.record(
            "placed_pairs",
            tuple[int, list[tuple[float, float]]],
            make,
            tuple(shown.items()),
            repr(views),
            library_versions()["pycolmap"],
        )
        right = sum(max(error) <= TOLERANCE_DEG for error in found)
        errors = np.array(found, float).reshape(-1, 2)
        return Measurements(
            medians={"rotation_deg": errors[:, 0], "direction_deg": errors[:, 1]},
            means={
                "registered": np.array([float(placed)]),
                "correct_pairs": np.array([right / (len(shown) * (len(shown) - 1) // 2)]),
            },
        )
