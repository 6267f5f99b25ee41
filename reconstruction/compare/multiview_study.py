"""The multi-view study of a comparison: depth of the middle camera from all, and the cloud fused from all."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.console.terminal import Progress
from capture_app.session.exporting.point_cloud import PointCloud, write_ply
from reconstruction.calibration.rig import Rig
from reconstruction.common.drawing import colour_depth, display_range, mark_movers
from reconstruction.common.geometry import Array, View
from reconstruction.common.native_libraries import library_versions
from reconstruction.compare.study import Study, write_pictures
from reconstruction.depth.coarse_scene import CoarseScene, find_coarse_scene
from reconstruction.depth.mesh import draw_clouds
from reconstruction.depth.view_choice import choose_reference_view, choose_source_views
from reconstruction.multiview.instant_depth import SWEEP, InstantDepth, compute_instant_depth
from reconstruction.multiview.instant_scoring import InstantScorer
from reconstruction.multiview.matcher import ChosenMatcher
from reconstruction.multiview.undistorted_session import UndistortedSession
from reconstruction.scores.study_result import InstantClouds, Picture, StudyResult
from reconstruction.scores.tally import Tally
from reconstruction.scores.truth import TOLERANCE_TEXT, right_depth
from reconstruction.session.conditions import Condition
from reconstruction.session.instants import (
    ShownInstant,
    choose_moving_instants,
    fullest_instants,
    relative_offsets_ms,
)

MIN_POINTS = 500
"""A synchronized cloud of fewer points shows nothing."""
MIN_CAMERAS = 3
MAX_CAMERAS = 5
"""More cameras make better clouds, but say no more about timing; each takes as long as the first."""
MAX_TRIES = 4
"""Instants tried to find one at which every camera has a usable picture."""


@dataclass(frozen=True)
class CameraGroup:
    """Cameras with overlapping views around a reference in their middle, and why others are left out."""

    reference: str = ""
    cameras: tuple[str, ...] = ()
    scene: CoarseScene = field(default_factory=lambda: CoarseScene({}, {}))
    """What a first look found of the scene."""
    left_out: Mapping[str, str] = field(default_factory=dict)


def choose_camera_group(shots: UndistortedSession, middle: int) -> CameraGroup:
    """Choose the cameras from synchronized pictures around the instant `middle`.

    Raises:
        ValueError: fewer than `MIN_CAMERAS` have overlapping views.
    """
    dataset = shots.dataset
    names, instants = dataset.cameras, range(len(dataset.instants_ns))
    counts = {k: sum(dataset.has_image(c, k) for c in names) for k in instants}
    fullest = sorted(instants, key=lambda k: (-counts[k], abs(k - middle)))[:MAX_TRIES]
    best = max(fullest, key=lambda k: sum(not shots.problem(c, k) for c in names))
    left_out = {c: problem for c in names if (problem := shots.problem(c, best))}
    images = {c: shots.image(c, best).calibrated for c in names if c not in left_out}
    _require_cameras(len(images), left_out)
    views = {camera: image.view for camera, image in images.items()}
    try:
        scene = find_coarse_scene(images)
    except BadInputError as error:
        raise ValueError(error.what) from error
    sources = choose_source_views({c: view for c, view in views.items() if c in scene.points}, scene.points)
    for camera in images:
        if len(sources.get(camera, ())) < 2:
            left_out[camera] = "overlaps too little with any two others"
            del views[camera]
    _require_cameras(len(views), left_out)
    reference = choose_reference_view(views, scene.points)
    nearest = [c for c in sources[reference] if c in views][: MAX_CAMERAS - 1]
    cameras = tuple(c for c in names if c == reference or c in nearest)
    for camera in views:
        if camera not in cameras:
            left_out[camera] = f"{MAX_CAMERAS} cameras are enough to compare conditions"
    _require_cameras(len(cameras), left_out)
    return CameraGroup(reference, cameras, scene, left_out)


def _require_cameras(count: int, left_out: Mapping[str, str]) -> None:
    if count < MIN_CAMERAS:
        text = [f"it takes {MIN_CAMERAS} cameras with overlapping views"]
        for reason in dict.fromkeys(left_out.values()):
            text.append(f"{', '.join(c for c, its in left_out.items() if its == reason)}: {reason}")
        raise ValueError("; ".join(text))


def save_clouds(
    instant: int, maps: Mapping[str, InstantDepth], view: View, moving: Array, out: Path
) -> InstantClouds | None:
    """Write both clouds into out/pictures; None where there is nothing to see.

    `view` and `moving` (bool) are the reference camera's: a page begins from its place, and turns about what
    moves.
    """
    if len(maps["synced"].points) < MIN_POINTS:
        return None
    paths = {}
    for side, found in maps.items():
        if len(found.points):
            paths[side] = f"pictures/cloud_{side}.ply"
            write_ply(out / paths[side], PointCloud(found.points, found.colours))
    return InstantClouds(
        instant=instant,
        **paths,
        rotation=tuple(view.rotation.ravel().tolist()),
        centre=tuple(view.centre.tolist()),
        focal=view.focal / view.width,
        pivot=tuple(_pivot(maps["synced"], view, moving).tolist()),
    )


def _pivot(synced: InstantDepth, view: View, moving: Array) -> Array:
    """The middle of what moves, else of everything, in the rig's frame."""
    known = synced.depth > 0
    rows, columns = np.nonzero(known & moving if (known & moving).any() else known)
    if not len(rows):
        return np.asarray(np.median(synced.points, axis=0))
    points = view.unproject(np.column_stack([columns, rows]), synced.depth[rows, columns].astype(float))
    return np.asarray(np.median(points, axis=0))


class MultiviewStudy(Study):
    """Depth from all cameras in any condition; what is fixed for all comes from synchronized pictures."""

    name = "multiview"

    def __init__(
        self,
        rig: Rig,
        max_instants: int,
        width: int,
        reference: str = "",
        matcher: ChosenMatcher = SWEEP,
    ) -> None:
        """Pictures wider than `width` px are made smaller; `reference`: refuse any other middle camera."""
        super().__init__(rig)
        self.max_instants = max_instants
        self.width = width
        self.reference = reference
        self.matcher = matcher
        self.group = CameraGroup()

    @property
    def steps(self) -> int:
        """One for choosing the cameras, and one for each instant and condition."""
        return 1 + 2 * min(self.max_instants, len(self.dataset.instants_ns))

    def for_session(self, rig: Rig) -> Self:
        """This middle camera of another session."""
        return type(self)(rig, self.max_instants, self.width, self.group.reference, self.matcher)

    @cached_property
    def shots(self) -> UndistortedSession:
        """The session's pictures, undistorted."""
        return UndistortedSession(self.dataset, self.motion, self.rig.views, self.width)

    def prepare(self, middle: int, progress: Progress) -> None:
        """As `Study.prepare`.

        Raises:
            ValueError: fewer than three calibrated cameras have overlapping views.
        """
        progress.step("choosing cameras for depth from all cameras")
        if not self.rig.views:
            raise ValueError("the cameras have no calibration")
        self.group = choose_camera_group(self.shots, middle)
        if self.reference not in ("", self.group.reference):
            raise ValueError(f"its middle camera is {self.group.reference}, not {self.reference}")

    def compare(self, condition: Condition, progress: Progress, folder: Path | None = None) -> StudyResult:
        """A condition against the synchronized one, on the same instants, pixels and cameras.

        Pictures of the instant with most moving pixels found go into the folder.

        Raises:
            ValueError: the burst does not hold this condition.
        """
        instants = self._instants(condition)
        found = []
        for one in instants:
            maps = {}
            for side, shown in one.sides.items():
                progress.step(f"depth from {len(shown)} cameras, instant {one.instant}, {side}")
                maps[side] = self._depth(shown)
            found.append(maps)
        scorer = InstantScorer(
            self.shots,
            self.group.reference,
            self.rig.unit,
            [one.instant for one in instants],
            [maps["synced"] for maps in found],
        )
        tally = Tally()
        for one, maps in zip(instants, found, strict=True):
            measured = scorer.measure(one.instant, one.shown, maps)
            pixels = measured["synced"].shares["mover_coverage"][1]
            facts = {"instant": one.instant, "mover_pixels": pixels, **one.delays_ms(self.dataset)}
            tally.add(measured, facts)
        pictures, clouds = self._show(instants, found, scorer, folder) if folder else ((), None)
        group = self.group
        return StudyResult(
            name=self.name,
            cameras=group.cameras,
            instants=tally.instants,
            offsets_ms=relative_offsets_ms(condition, self.dataset, group.reference, group.cameras),
            measures=tally.measures,
            per_instant=tally.per_instant,
            pictures=pictures,
            facts={
                "reference": group.reference,
                "tolerance_m": scorer.tolerance_m,
                "width_px": self.shots.views[group.reference].width,
                "matcher": self.matcher.name,
                "matcher_note": self.matcher.note,
                "clouds": clouds,
                "left_out": dict(group.left_out),
                "cloud_skipped": scorer.cloud_skipped,
            },
        )

    def _instants(self, condition: Condition) -> list[ShownInstant]:
        """The instants at which most cameras have their pictures in both conditions and something moves."""
        reference, problem = self.group.reference, self.shots.problem
        fullest = fullest_instants(self.dataset, condition, reference, self.group.cameras)
        by_instant = {one.instant: one.shown for one in fullest}
        found = []
        for now in choose_moving_instants(self.motion, (reference,), list(by_instant), self.max_instants):
            shown = {c: k for c, k in by_instant[now].items() if not (problem(c, now) or problem(c, k))}
            if reference in shown and len(shown) >= MIN_CAMERAS:
                found.append(ShownInstant(now, shown))
        if not found:
            raise ValueError("no instant has its pictures in both conditions")
        return found

    def _depth(self, shown: dict[str, int]) -> InstantDepth:
        shots = {camera: self.shots.image(camera, instant) for camera, instant in shown.items()}
        views = {camera: shot.calibrated.view for camera, shot in shots.items()}
        sources = choose_source_views(views, self.group.scene.points)
        if not sources[self.group.reference]:
            raise ValueError(f"no camera with a picture overlaps with {self.group.reference}")
        reach = {camera: self.group.scene.depth_ranges[camera] for camera in shown}
        return self.rig.stages.arrays(
            "multiview",
            InstantDepth,
            lambda: compute_instant_depth(shots, sources, reach, self.group.reference, self.matcher),
            self.group.reference,
            tuple(shown.items()),
            repr(views),
            tuple(reach.items()),
            library_versions()["pycolmap"],
            self.matcher.name,
            self.matcher.quick,
        )

    def _show(
        self,
        instants: list[ShownInstant],
        found: list[dict[str, InstantDepth]],
        scorer: InstantScorer,
        folder: Path,
    ) -> tuple[tuple[Picture, ...], InstantClouds | None]:
        """Pictures and clouds of the instant at which most of what moves was found."""
        moving = [self.shots.moving(self.group.reference, one.instant) for one in instants]
        seen = [
            int((mask & (maps["synced"].depth > 0)).sum()) for mask, maps in zip(moving, found, strict=True)
        ]
        best = int(np.argmax(seen))
        instant = instants[best].instant
        shot = self.shots.image(self.group.reference, instant)
        pictures = _draw_depth(shot.colours, found[best], moving[best], scorer.true_depth(instant), folder)
        pictures += self._draw_turntable(instants[best], found[best], folder)
        return pictures, save_clouds(instant, found[best], shot.calibrated.view, moving[best], folder)

    def _draw_turntable(
        self, one: ShownInstant, maps: Mapping[str, InstantDepth], folder: Path
    ) -> tuple[Picture, ...]:
        """Both clouds from six places; none where there is nothing to see."""
        if len(maps["synced"].points) < MIN_POINTS:
            return ()
        clouds = {side: (found.points, found.colours) for side, found in maps.items()}
        views = [self.shots.image(camera, k).calibrated.view for camera, k in one.together.items()]
        drawn = draw_clouds(clouds, views)
        caption = "The points of all cameras, from six places."
        pictures = {side: {"multiview_turntable": picture} for side, picture in drawn.items()}
        return write_pictures(pictures, {"multiview_turntable": ("All around", caption)}, folder)


def _draw_depth(
    photo: Array, maps: Mapping[str, InstantDepth], moving: Array, truth: Array | None, out: Path
) -> tuple[Picture, ...]:
    """Distance and what moves (bool) of one instant in both conditions, in out/pictures.

    `photo` (BGR) is the reference's undistorted picture; `truth` is in the maps' unit, NaN = unknown.
    """
    near, far = display_range(maps["synced"].depth, moving)
    drawn = {}
    for side, found in maps.items():
        right = found.depth > 0
        if truth is not None:
            right &= right_depth(found.depth, truth)
        depth = colour_depth(found.depth, near, far)
        drawn[side] = {"multiview_depth": depth, "multiview_movers": mark_movers(photo, moving, right)}
    judged = f"it is right {TOLERANCE_TEXT}" if truth is not None else "the other cameras agree"
    distance = (
        "Bright is near, blue is far; dark means that no distance was found. On one side are the pictures "
        "that were recorded as one instant, on the other each camera is off by a different delay."
    )
    movers = f"Teal: a distance was found, and {judged}. Orange: none, or a wrong one."
    texts = {
        "multiview_depth": ("Distance from all cameras", distance),
        "multiview_movers": ("What moves, by all cameras", movers),
    }
    return write_pictures(drawn, texts, out)
