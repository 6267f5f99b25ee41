"""Points in space by COLMAP: its features and matches, triangulated under the rig's known poses."""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from reconstruction.common.foreign_calls import foreign_calls
from reconstruction.common.geometry import Array, View
from reconstruction.common.native_libraries import load_pycolmap
from reconstruction.session.dataset import Dataset

MAX_SIDE_PX = 1280
"""Larger pictures are made smaller for finding features."""
MAX_FEATURES = 2048
MAX_ERROR_PX = 2.0
"""Of a match and of a point, in the picture that features are found in. COLMAP's own 4 px are for poses still
to be found, and let points through that have moved."""
MIN_ANGLE_DEG = 0.5
"""Rays that meet at less than this place no point; COLMAP's own 1.5 is too much for cameras side by side."""
NO_LIMIT = 1e9
KEPT_PICTURES = 64
PURPOSE = "triangulating points"


@dataclass(frozen=True, eq=False)
class RigPoints:
    """Points that at least two cameras see, and where each of these sees them.

    `points` (n, 3) in the rig's frame; `errors` (n,): mean reprojection error, px of the undistorted
    pictures. Of every observation: `point`, `camera` (its place among those given) (m,), and
    `pixel` (m, 2), the one of the camera's picture, column and row.
    """

    points: Array
    errors: Array
    point: Array
    camera: Array
    pixel: Array


@dataclass(frozen=True, eq=False)
class _Features:
    """COLMAP's features of a picture: positions (n, 2) px in the picture, first pixel's centre at (0, 0)."""

    positions: Array
    descriptors: Any
    scale: float
    """Of the picture that they were found in."""


class RigTriangulator:
    """Points of any set of pictures of calibrated cameras; the features of a picture are found once."""

    def __init__(self, dataset: Dataset, views: Mapping[str, View]) -> None:
        """Raises NotAvailableError where COLMAP is not installed."""
        self._colmap: Any = load_pycolmap(PURPOSE)
        self._dataset = dataset
        self._views = views
        self._features = lru_cache(maxsize=KEPT_PICTURES)(self._find_features)

    def triangulate(self, shown: Mapping[str, int]) -> RigPoints:
        """The points that these cameras (two or more) see, each at its instant.

        Raises:
            ForeignError: COLMAP failed.
        """
        found = {camera: self._features(camera, instant) for camera, instant in shown.items()}
        with (
            tempfile.TemporaryDirectory(prefix="simulshot-") as scratch,
            foreign_calls("COLMAP", PURPOSE),
        ):
            database = Path(scratch) / "database.db"
            model = self._write_database(database, found)
            limit = MAX_ERROR_PX / min(features.scale for features in found.values())
            self._match(database, model, limit)
            return _rig_points(self._place_points(database, model, limit), found)

    def _find_features(self, camera: str, instant: int) -> _Features:
        grey = self._dataset.grey(camera, instant)
        scale = min(1.0, MAX_SIDE_PX / max(grey.shape))
        if scale < 1:
            grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        options = self._colmap.FeatureExtractionOptions(num_threads=1)
        options.sift.max_num_features = MAX_FEATURES
        with foreign_calls("COLMAP", "finding features"):
            extractor = self._colmap.FeatureExtractor.create(options, self._colmap.Device.cpu)
            keypoints, descriptors = extractor.extract_from_uint8_array(np.ascontiguousarray(grey))
            places = np.asarray(self._colmap.keypoints_to_matrix(keypoints), float)[:, :2]
        # COLMAP's first pixel has its centre at (0.5, 0.5).
        return _Features(places / scale - 0.5, descriptors, scale)

    def _write_database(self, path: Path, found: Mapping[str, _Features]) -> Any:
        """Write cameras and features into a new database; the same with the rig's poses, without points.

        Pictures are undistorted point by point: COLMAP refuses some strong distortions that OpenCV allows.
        """
        colmap = self._colmap
        model = colmap.Reconstruction()
        database = colmap.Database.open(path)
        for number, (name, features) in enumerate(found.items(), 1):
            view = self._views[name]
            camera = _pinhole(colmap, view, number)
            database.write_camera(camera, use_camera_id=True)
            model.add_camera_with_trivial_rig(camera)
            database.write_rig(model.rig(number), use_rig_id=True)
            places = np.zeros((0, 2))
            if len(features.positions):
                places = view.rays(features.positions) @ view.matrix.T
            places = places[:, :2] + 0.5
            pose = colmap.Rigid3d(colmap.Rotation3d(view.rotation), view.translation)
            image = colmap.Image(name=name, keypoints=places, camera_id=number, image_id=number)
            model.add_image_with_trivial_frame(image, pose)
            database.write_frame(model.frame(number), use_frame_id=True)
            database.write_image(model.image(number), use_image_id=True)
            database.write_keypoints(number, places.astype(np.float32))
            database.write_descriptors(number, features.descriptors)
        database.close()
        return model

    def _match(self, database: Path, model: Any, limit_px: float) -> None:
        """Match every two pictures, and keep what fits the known poses."""
        colmap = self._colmap
        matching = colmap.FeatureMatchingOptions(skip_geometric_verification=True, num_threads=1)
        colmap.match_exhaustive(database, matching, device=colmap.Device.cpu)
        # A pair counts however few matches it has: what moves may be small.
        verification = colmap.TwoViewGeometryOptions(min_num_inliers=1)
        verification.ransac.random_seed = 0
        verification.ransac.max_error = limit_px
        colmap.guided_geometric_verification(
            model, database, two_view_geometry_options=verification, num_threads=1
        )

    def _place_points(self, database: Path, model: Any, limit_px: float) -> Any:
        colmap = self._colmap
        options = colmap.IncrementalPipelineOptions(
            random_seed=0,
            num_threads=1,
            min_num_matches=1,
            extract_colors=False,
            max_focal_length_ratio=NO_LIMIT,
            min_focal_length_ratio=1 / NO_LIMIT,
        )
        options.triangulation.ignore_two_view_tracks = False
        options.triangulation.min_angle = MIN_ANGLE_DEG
        options.triangulation.merge_max_reproj_error = limit_px
        options.triangulation.complete_max_reproj_error = limit_px
        options.mapper.filter_min_tri_angle = MIN_ANGLE_DEG
        options.mapper.filter_max_reproj_error = limit_px
        folder = database.parent / "model"
        folder.mkdir()
        return colmap.triangulate_points(model, database, database.parent, folder, options=options)


def _pinhole(colmap: Any, view: View, number: int) -> Any:
    """The view without its distortion."""
    m = view.matrix
    return colmap.Camera(
        model="PINHOLE",
        width=view.width,
        height=view.height,
        params=[m[0, 0], m[1, 1], m[0, 2] + 0.5, m[1, 2] + 0.5],
        camera_id=number,
        has_prior_focal_length=True,
    )


def _rig_points(model: Any, found: Mapping[str, _Features]) -> RigPoints:
    positions = [features.positions for features in found.values()]
    points, errors, seen, pixels = [], [], [], []
    for index, (_, point) in enumerate(sorted(model.points3D.items())):
        points.append(point.xyz)
        errors.append(point.error)
        for element in point.track.elements:
            place = element.image_id - 1
            seen.append((index, place))
            pixels.append(positions[place][element.point2D_idx])
    where = np.array(seen, int).reshape(-1, 2)
    return RigPoints(
        points=np.array(points, float).reshape(-1, 3),
        errors=np.array(errors, float),
        point=where[:, 0],
        camera=where[:, 1],
        pixel=np.round(np.array(pixels, float)).astype(int).reshape(-1, 2),
    )
