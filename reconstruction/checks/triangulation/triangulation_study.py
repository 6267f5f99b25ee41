"""Points that COLMAP matches and triangulates with the rig's known poses."""

import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np

from reconstruction.checks.triangulation.triangulation_check import Triangulation
from reconstruction.common.colmap import build_model, load_pycolmap
from reconstruction.common.drawing import colour_depth, display_range, mark_moving
from reconstruction.common.geometry import Array, View
from reconstruction.common.native_libraries import foreign_calls
from reconstruction.method.score import Score
from reconstruction.method.study_result import Picture, StudyResult
from reconstruction.method.tally import Measurements, Tally
from reconstruction.method.truth import right_depth
from reconstruction.method.words import read_words
from reconstruction.scene.conditions import ALL_APART, Condition
from reconstruction.scene.instant_choice import (
    ShownInstant,
    complete_instants,
    relative_offsets_ms,
)
from reconstruction.scene.moving_pixels import dilate
from reconstruction.scene.pairs import Features, size_above_features
from reconstruction.scene.scene import Scene

MAX_ERROR_PX = 2.0
"""Maximum match and reprojection error, in the image that features are detected in.

COLMAP's default of 4 px is meant for unknown poses, and accepts points that have moved.
"""
MIN_ANGLE_DEG = 0.5
"""Minimum angle between a point's rays; COLMAP's default of 1.5 is too large for cameras side by side."""
NO_LIMIT = 1e9
MAX_CAMERAS = 5
"""More cameras find more points, but say no more about timing."""
INSTANT_LIMITS = (3, 8)
PURPOSE = "triangulating points"


@dataclass(frozen=True, eq=False)
class SeenPoints:
    """Points seen by at least two cameras, and their observations.

    `points` (n, 3) are in the rig's frame. `errors` (n,) are mean reprojection errors, px of the undistorted
    images. Each observation has `point` and `camera`, an index into the given cameras, (m,), and `pixel` (m,
    2), column and row in the camera's image.
    """

    points: Array
    errors: Array
    point: Array
    camera: Array
    pixel: Array


def triangulate(scene: Scene, shown: Mapping[str, int]) -> SeenPoints:
    """Triangulate the points that these cameras (two or more) see, each at its instant.

    Features are the rig's, detected once for all studies; COLMAP does all else.

    Raises:
        NotAvailableError: COLMAP is not installed.
        ForeignError: COLMAP failed.
    """
    colmap = load_pycolmap(PURPOSE)
    features = {camera: scene.features.of_image(camera, instant) for camera, instant in shown.items()}
    limit = MAX_ERROR_PX * max(size_above_features(*scene.dataset.size(camera)) for camera in shown)
    with (
        tempfile.TemporaryDirectory(prefix="simulshot-") as scratch,
        foreign_calls("COLMAP", PURPOSE),
    ):
        database = Path(scratch) / "database.db"
        model = _write_database(colmap, database, scene.views, features)
        _match(colmap, database, model, limit)
        return _rig_points(_place_points(colmap, database, model, limit), features)


def _write_database(colmap: Any, path: Path, views: Mapping[str, View], found: Mapping[str, Features]) -> Any:
    """Write cameras and features into a new database; return a model with the rig's poses, without points.

    Feature positions are undistorted one by one: COLMAP rejects some strong distortions that OpenCV allows.
    """
    places = {name: views[name].undistort(features.positions) for name, features in found.items()}
    model = build_model(colmap, {name: views[name] for name in found}, places, corner=0.5)
    database = colmap.Database.open(path)
    for number, (name, features) in enumerate(found.items(), 1):
        database.write_camera(model.camera(number), use_camera_id=True)
        database.write_rig(model.rig(number), use_rig_id=True)
        database.write_frame(model.frame(number), use_frame_id=True)
        database.write_image(model.image(number), use_image_id=True)
        database.write_keypoints(number, (places[name] + 0.5).astype(np.float32))
        # As in COLMAP's SIFT: 512 times the root of the L1-normalized values.
        shares = features.descriptors / np.maximum(features.descriptors.sum(1, keepdims=True), 1e-7)
        roots = np.rint(512 * np.sqrt(shares)).clip(0, 255).astype(np.uint8)
        database.write_descriptors(number, colmap.FeatureDescriptors(colmap.FeatureExtractorType.SIFT, roots))
    database.close()
    return model


def _match(colmap: Any, database: Path, model: Any, limit_px: float) -> None:
    """Match every two images, and keep the matches that fit the known poses."""
    matching = colmap.FeatureMatchingOptions(skip_geometric_verification=True, num_threads=1)
    colmap.match_exhaustive(database, matching, device=colmap.Device.cpu)
    # A pair counts however few matches it has: moving objects may be small.
    verification = colmap.TwoViewGeometryOptions(
        min_num_inliers=1, ransac={"random_seed": 0, "max_error": limit_px}
    )
    colmap.guided_geometric_verification(
        model, database, two_view_geometry_options=verification, num_threads=1
    )


def _place_points(colmap: Any, database: Path, model: Any, limit_px: float) -> Any:
    options = colmap.IncrementalPipelineOptions(
        random_seed=0,
        num_threads=1,
        min_num_matches=1,
        extract_colors=False,
        max_focal_length_ratio=NO_LIMIT,
        min_focal_length_ratio=1 / NO_LIMIT,
        triangulation={
            "ignore_two_view_tracks": False,
            "min_angle": MIN_ANGLE_DEG,
            "merge_max_reproj_error": limit_px,
            "complete_max_reproj_error": limit_px,
        },
        mapper={"filter_min_tri_angle": MIN_ANGLE_DEG, "filter_max_reproj_error": limit_px},
    )
    folder = database.parent / "model"
    folder.mkdir()
    return colmap.triangulate_points(model, database, database.parent, folder, options=options)


def _rig_points(model: Any, found: Mapping[str, Features]) -> SeenPoints:
    positions = [features.positions for features in found.values()]
    points = [point for _, point in sorted(model.points3D.items())]
    seen = [(index, element) for index, point in enumerate(points) for element in point.track.elements]
    pixels = [positions[seen_there.image_id - 1][seen_there.point2D_idx] for _, seen_there in seen]
    return SeenPoints(
        points=np.array([point.xyz for point in points], float).reshape(-1, 3),
        errors=np.array([point.error for point in points], float),
        point=np.array([index for index, _ in seen], int),
        camera=np.array([seen_there.image_id - 1 for _, seen_there in seen], int),
        pixel=np.round(np.array(pixels, float)).astype(int).reshape(-1, 2),
    )


def _depth_at(view: View, found: SeenPoints, camera: int) -> tuple[Array, Array]:
    """Return the pixels (n, 2) at which a camera sees points, inside its image, and their depth (n,)."""
    mine = found.camera == camera
    points = found.points[found.point[mine]]
    pixels = found.pixel[mine].clip(0, (view.width - 1, view.height - 1))
    return pixels, (points @ view.rotation.T + view.translation)[:, 2]


class TriangulationStudy(Score):
    """COLMAP's points on moving and still objects, from the same cameras in both conditions."""

    text = read_words(__package__)
    needs = Triangulation.needs
    needs_calibration = True
    packages = ("pycolmap",)

    @property
    def steps(self) -> int:
        """Number of progress lines: one for the choice of cameras, and one for each instant."""
        return 1 + min(self.context.max_instants, INSTANT_LIMITS[1], len(self.dataset.instants_ns))

    def adopt(self, ours: Self) -> None:
        """Use the cameras that this study chose in the first session of the comparison."""
        self.cameras = ours.cameras

    def prepare(self) -> None:
        """Choose the cameras and the condition; see `Score.prepare`.

        Raises:
            ValueError: fewer than two cameras are calibrated, or the burst does not contain the offset.
        """
        self.progress.step("choosing cameras for points by COLMAP")
        self.cameras = self._choose_cameras()
        # The second camera is delayed where the burst has no delays of all cameras.
        with suppress(ValueError):
            if self.context.offset is None or (len(self.cameras) > 2 and self._instants(ALL_APART)):
                return
        if offset := self.context.offset:
            late = tuple((camera, offset.actual_ms) for camera in self.cameras[1::2])
            self.condition = Condition(f"{offset.asked_ms:g}ms", named_ms=late)

    def compare(self, condition: Condition, folder: Path | None = None) -> StudyResult[dict[str, list[str]]]:
        """Compare a condition; draw the instant with the most moving points into the folder.

        The facts name the calibrated cameras that take no part.

        Raises:
            ValueError: the burst does not contain this condition, or COLMAP finds no point when synchronized.
        """
        tally = Tally()
        found, max_moving, pictures = 0, -1.0, tuple[Picture, ...]()
        for moment in self._instants(condition):
            self.progress.step(f"points by COLMAP from {len(moment.shown)} cameras, instant {moment.instant}")
            points = {side: self._points(pictures) for side, pictures in moment.by_condition.items()}
            found += len(points["synced"].points)
            measured = {side: self._measure(points[side], moment, side) for side in points}
            tally.add(measured, {"instant": moment.instant, **moment.delays_ms(self.dataset)})
            moving = float(np.sum(measured["synced"].means["mover_points"]))
            if folder and moving > max_moving:
                max_moving, pictures = moving, self._draw(moment, points, folder)
        if not found:
            raise ValueError(f"COLMAP finds no point that two of {', '.join(self.cameras)} see")
        return StudyResult(
            name=self.text.name,
            cameras=self.cameras,
            instants=tally.instants,
            offsets_ms=relative_offsets_ms(condition, self.dataset, self.cameras[0], self.cameras),
            measures=tally.measures,
            per_instant=tally.per_instant,
            pictures=pictures,
            facts={"left_out": [c for c in self.scene.views if c not in self.cameras]},
        )

    def _choose_cameras(self) -> tuple[str, ...]:
        """Return the depth pair and the cameras nearest to it; without one, those nearest to the centre."""
        views = self.scene.views
        if missing := [c for c in self.cameras if c not in views]:
            raise ValueError(f"no calibration of {', '.join(missing)}")
        if self.cameras:
            return self.cameras
        if len(views) < 2:
            raise ValueError("points are placed by two calibrated cameras or more")
        depth = self.known.study("stereo")
        pair = [c for c in depth.cameras if c in views] if depth is not None else []
        middle = np.mean([views[c].centre for c in pair or views], axis=0)
        near = sorted(views, key=lambda c: float(np.linalg.norm(views[c].centre - middle)))
        chosen = [*pair, *(c for c in near if c not in pair)][:MAX_CAMERAS]
        # Of two cameras the second is delayed, as in the depth pair.
        return tuple(chosen if len(chosen) == 2 else [c for c in views if c in chosen])

    def _instants(self, condition: Condition) -> list[ShownInstant]:
        """Return instants with motion at which most cameras have all their images."""
        complete = complete_instants(self.dataset, condition, self.cameras[0], self.cameras, min_cameras=2)
        # Features of about 24 images are matched.
        limit = int(np.clip(24 // (2 * len(complete[0].shown) - 1), *INSTANT_LIMITS))
        limit = min(limit, self.context.max_instants)
        first = list(complete[0].shown)[:2]
        return self.moving_moments([one for one in complete if one.shown.keys() >= {*first}], first, limit)

    def _draw(self, one: ShownInstant, points: Mapping[str, SeenPoints], folder: Path) -> tuple[Picture, ...]:
        """Draw both conditions' points on the first camera's picture, coloured by their distance."""
        camera = self.cameras[0]
        view, photo = self.scene.views[camera], self.dataset.image(camera, one.instant)
        moving = self.motion.moving(camera, one.instant)
        seen = {
            side: _depth_at(view, own_points, list(one.shown).index(camera))
            for side, own_points in points.items()
        }
        limits = display_range(seen["synced"][1], moving[seen["synced"][0][:, 1], seen["synced"][0][:, 0]])
        radius = max(2, round(view.width / 220))
        drawn = {}
        for side, (pixels, depth) in seen.items():
            picture = mark_moving(photo, moving, np.zeros_like(moving)) // 2
            colours = colour_depth(depth[None], *limits)[0].tolist()
            for place in np.argsort(-depth):
                cv2.circle(picture, pixels[place].tolist(), radius, colours[place], -1, cv2.LINE_AA)
            drawn[side] = {"triangulation_points": picture}
        return self.write_pictures(drawn, folder)

    def _points(self, shown: Mapping[str, int]) -> SeenPoints:
        return self.scene.once(("points", *shown.items()), lambda: triangulate(self.compared, shown))

    def _measure(self, found: SeenPoints, one: ShownInstant, side: str) -> Measurements:
        """Measure points on moving objects (in at least half of their images) and on the still control."""
        moving, hidden, right, known = np.zeros((4, len(found.point)), bool)
        anything = False
        for place, (camera, instant) in enumerate(one.by_condition[side].items()):
            mine = found.camera == place
            columns, rows = found.pixel[mine].T.clip(0, np.array([self.dataset.size(camera)]).T - 1)
            moves = self.motion.moving(camera, instant)
            anything |= bool(moves.any())
            moving[mine] = moves[rows, columns]
            changing = [self.motion.changing(camera, shown[camera]) for shown in one.by_condition.values()]
            hidden[mine] = dilate(np.logical_or.reduce(changing), 4)[rows, columns]
            truth = self.dataset.ground_truth(camera, instant) if self.scene.unit == "m" else None
            if truth is not None:
                _, depth = _depth_at(self.scene.views[camera], found, place)
                true = truth[0][rows, columns]
                right[mine], known[mine] = right_depth(depth, true), true > 0

        def count(which: Array) -> Array:
            """Return the number of each point's observations that are selected (bool)."""
            return np.bincount(found.point[which], minlength=len(found.points))

        seen = count(np.ones_like(moving))
        on_moving = 2 * count(moving) >= seen
        judged = count(known) == seen
        correct = 2 * count(right) >= seen
        still = (count(hidden) == 0) & ~on_moving
        measured = Measurements()
        for kind, mask, there in (("mover", on_moving, anything), ("static", still, True)):
            measured.means[f"{kind}_points"] = np.array([float(mask.sum())] * there)
            measured.medians[f"{kind}_reprojection_px"] = found.errors[mask]
            measured.shares[f"{kind}_precision"] = (
                int((correct & judged & mask).sum()),
                int((judged & mask).sum()),
            )
        return measured
