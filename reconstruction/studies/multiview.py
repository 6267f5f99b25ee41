"""Depth of the middle camera from all cameras, and the cloud fused from all."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Self

import click
import msgspec
import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.exporting.point_cloud import PointCloud, write_ply
from reconstruction.commands.command_options import MATCHER, flag
from reconstruction.common.drawing import colour_depth, display_range, mark_moving
from reconstruction.common.geometry import Array, View
from reconstruction.common.native_libraries import library_versions
from reconstruction.common.worker_pool import worker_pool
from reconstruction.compare.study import UNASKED, ConditionStudy, Context, PictureText, write_pictures
from reconstruction.depth.mesh import draw_clouds
from reconstruction.depth.rough_scene import RoughScene, find_rough_scene
from reconstruction.depth.view_choice import choose_reference_view, choose_source_views
from reconstruction.multiview.input_images import UndistortedSession
from reconstruction.multiview.instant_depth import NO_PLANES, InstantDepth, compute_instant_depth
from reconstruction.multiview.instant_scoring import InstantScorer
from reconstruction.multiview.matcher import ChosenMatcher, Matcher, choose_matcher
from reconstruction.report import wording
from reconstruction.report.embedding import view_clouds
from reconstruction.report.findings import EACH_DELAYED, depth_sentence
from reconstruction.report.study_report import CORRECT, COVERAGE, POINTS, WITHIN, MeasureText, StudyText
from reconstruction.scores.comparison_results import CompareResult
from reconstruction.scores.study_result import InstantClouds, Picture, StudyResult
from reconstruction.scores.tally import Tally
from reconstruction.scores.truth import TOLERANCE_TEXT, right_depth
from reconstruction.session.conditions import Condition
from reconstruction.session.instant_choice import (
    ShownInstant,
    choose_moving_instants,
    complete_instants,
    relative_offsets_ms,
)

MIN_POINTS = 500
"""Minimum points of a synchronized cloud worth showing."""
MIN_CAMERAS = 3
MAX_CAMERAS = 5
"""More cameras improve the cloud but say no more about timing; each takes as long as the first."""
AT_A_TIME = 2
"""Number of conditions whose depth is computed at a time, and of instants that are scored."""
MAX_TRIES = 4
"""Number of instants tried until every camera has a usable image."""
SECTION = """
{% from "figures.html" import figure with context %}
{% from "tables.html" import table, folded %}
{% set many = view.found %}
<section aria-labelledby="{{ section.anchor }}">
<h2 id="{{ section.anchor }}">{{ section.title }}</h2>
<p>Distance from {{ many.cameras|length|count("camera") }} at once: it counts only where several of
them agree. {{ view.delays|keep_units }}</p>
{% set cloud = view.cloud %}
{% if cloud %}
{% include "cloud.html" %}
{% endif %}
{% for picture in many.pictures %}
{{ figure(picture, view.conditions, view.engine if loop.first) }}
{% endfor %}
{{ table(view.table) }}
{% for camera, why in view.found.facts.left_out.items() %}
<p class="quiet">No depth of {{ camera }}: {{ why }}.</p>
{% endfor %}
{% if many.facts.cloud_skipped %}
<p class="quiet">No point cloud: {{ many.facts.cloud_skipped }}.</p>
{% endif %}
{{ folded("Every instant, all cameras", view.instants) }}
</section>
"""


@dataclass(frozen=True)
class CameraGroup:
    """Cameras with overlapping views around a central reference, and reasons why others are left out."""

    reference: str = ""
    cameras: tuple[str, ...] = ()
    scene: RoughScene = field(default_factory=lambda: RoughScene({}, {}))
    """Coarse scene found by a first look."""
    left_out: Mapping[str, str] = field(default_factory=dict)


def choose_camera_group(shots: UndistortedSession, middle: int) -> CameraGroup:
    """Choose the cameras from synchronized images around the instant `middle`.

    Raises:
        ValueError: fewer than `MIN_CAMERAS` have overlapping views.
    """
    dataset = shots.dataset
    names, instants = dataset.cameras, range(len(dataset.instants_ns))
    counts = {k: sum(dataset.has_image(c, k) for c in names) for k in instants}
    complete = sorted(instants, key=lambda k: (-counts[k], abs(k - middle)))[:MAX_TRIES]
    best = max(complete, key=lambda k: sum(not shots.problem(c, k) for c in names))
    left_out = {c: problem for c in names if (problem := shots.problem(c, best))}
    images = {c: shots.image(c, best).calibrated for c in names if c not in left_out}
    _require_cameras(len(images), left_out)
    views = {camera: image.view for camera, image in images.items()}
    try:
        scene = find_rough_scene(images)
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
    """Write both clouds into out/pictures; None if they have too few points.

    `view` and `moving` (bool) belong to the reference camera. A page starts from its position and rotates
    about the moving objects.
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
    """Return the centre of the moving points, else of all points, in the rig's frame."""
    known = synced.depth > 0
    rows, columns = np.nonzero(known & moving if (known & moving).any() else known)
    if not len(rows):
        return np.asarray(np.median(synced.points, axis=0))
    points = view.unproject(np.column_stack([columns, rows]), synced.depth[rows, columns].astype(float))
    return np.asarray(np.median(points, axis=0))


class MultiviewOptions(msgspec.Struct, frozen=True, kw_only=True):
    """Options of the study of depth from all cameras."""

    multiview_instants: Annotated[
        int,
        flag(
            "--max-multiview-instants",
            type=click.IntRange(min=0),
            metavar="N",
            help="Use at most this many instants for depth from all cameras, which takes much longer; 0 for "
            "none.",
        ),
    ] = 3
    multiview_width: Annotated[
        int,
        flag(
            "--multiview-width",
            type=click.IntRange(min=160),
            metavar="PX",
            help="Reduce wider images to this width for depth from all cameras.",
        ),
    ] = 640
    matcher: Annotated[Matcher, flag("--matcher", **MATCHER)] = Matcher.AUTO


class MultiviewFacts(msgspec.Struct, frozen=True, kw_only=True):
    """Results that only the multiview study has: its clouds, cameras and matcher."""

    reference: str
    """The middle camera, on whose pixels depth is scored."""
    tolerance_m: float | None
    """Distance within which a point of the cloud is correct."""
    width_px: int
    matcher: str
    matcher_note: str
    """Reason for this matcher, or the hardware it runs on."""
    clouds: InstantClouds | None
    left_out: dict[str, str]
    """Why other cameras take no part."""
    cloud_skipped: str
    """Why there is no cloud; empty if there is one."""


class MultiviewStudy(ConditionStudy):
    """Depth from all cameras in any condition; synchronized images determine what all conditions share."""

    text = StudyText(
        name="multiview",
        subject="depth from all cameras",
        place=10,
        replaces="stereo",
        term="All cameras",
        caption="Depth from {cameras}, as {reference} sees it",
        measures=(
            *CORRECT,
            MeasureText(
                "coverage",
                COVERAGE,
                "Share for which at least three cameras agree on a distance. More is better.",
            ),
            MeasureText(
                "consistency",
                "Confirmed by other cameras",
                "Share whose distance two other cameras find independently, before other checks. "
                "More is better.",
            ),
            MeasureText(
                "photometric_error",
                "Brightness mismatch",
                "The other pictures are laid over this one by the distances found; this is how far the "
                "brightness differs, of 255. Less is better.",
                wording.PLAIN,
            ),
            MeasureText(
                "points",
                POINTS,
                "In the cloud fused from all cameras, the median over the instants.",
                wording.COUNT,
            ),
            MeasureText(
                "f_score",
                "Reconstructed surface",
                "How well the cloud and the true surface agree{near} (F-score): 100 % is the whole surface "
                "and nothing else. More is better.",
            ),
            MeasureText("precision", "Correct points", "Share of the points on a true surface{near}."),
            MeasureText("recall", "Surface covered", "Share of the true surface with a point{near}."),
        ),
        condition_columns=(
            ("mover_within_2pct", f"All cameras: {WITHIN.lower()}"),
            ("mover_coverage", f"All cameras: {COVERAGE.lower()}"),
        ),
        instant_columns=(
            ("mover_within_2pct", WITHIN),
            ("mover_coverage", COVERAGE),
            ("mover_points", POINTS),
        ),
        section=SECTION,
        title="With all cameras at once",
        section_place=50,
        scripts=("cloud.js",),
        engine="Distances are found by {matcher}.",
        details="pictures {width} px wide",
    )
    Options = MultiviewOptions

    @classmethod
    def placeholders(cls, found: StudyResult[MultiviewFacts]) -> dict[str, str]:
        """Return values for the names in braces; see `StudyReport.placeholders`."""
        facts = found.facts
        if facts is None:
            return super().placeholders(found)
        tolerance_m, patchmatch = facts.tolerance_m, facts.matcher == Matcher.PATCHMATCH
        near = "" if tolerance_m is None else f" to within {100 * tolerance_m:.3g}{wording.GAP}cm"
        return super().placeholders(found) | {
            "reference": facts.reference,
            "near": near,
            "matcher": "COLMAP's PatchMatch on a GPU" if patchmatch else "our own plane sweep, not by COLMAP",
            "width": f"{facts.width_px}",
        }

    @classmethod
    def verdict(cls, result: CompareResult, found: StudyResult[MultiviewFacts]) -> str:
        """Return the sentence on depth; see `StudyReport.verdict`."""
        cameras, when = f"all {len(found.cameras)} cameras", "the pictures of {} are paired as recorded"
        if result.together(found.cameras):
            when = "{} show the same instant"
        return depth_sentence(found, when.format(cameras), EACH_DELAYED, "several cameras agree on")

    @classmethod
    def view(cls, found: StudyResult[MultiviewFacts], heads: Mapping[str, str], out: Path) -> dict[str, Any]:
        """Return the cloud for the page's 3D view; see `StudyReport.view`."""
        facts = found.facts
        if facts is None or facts.clouds is None:
            return {"cloud": None}
        return {"cloud": view_clouds(facts.clouds, out, facts.reference, len(found.cameras))}

    @classmethod
    def files(cls, found: StudyResult[MultiviewFacts]) -> dict[str, Sequence[str]]:
        """Return the paths of both clouds; see `StudyReport.files`."""
        clouds = found.facts.clouds if found.facts is not None else None
        return {"the cloud of one instant in both": [clouds.synced, clouds.offset]} if clouds else {}

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self.options: MultiviewOptions
        self.middle_camera = ""
        """Required middle camera; any other is rejected. Empty accepts all."""
        self.group = CameraGroup()

    @property
    def steps(self) -> int:
        """Number of progress lines: one for the choice of cameras, and one for each instant and condition."""
        limit = self.options.multiview_instants
        return 1 + 2 * min(limit, len(self.dataset.instants_ns)) if limit else 0

    def unasked(self) -> str:
        """Return a reason if the options allow the study no instants, else empty; see `Study.unasked`."""
        return "" if self.options.multiview_instants else UNASKED

    def check(self) -> None:
        """Reject a matcher that this machine cannot run; see `Study.check`."""
        if self.options.matcher.engine is not Matcher.SWEEP:
            self.matcher  # noqa: B018

    def adopt(self, ours: Self) -> None:
        """Use the middle camera of the comparison's own session."""
        self.middle_camera = ours.group.reference

    @cached_property
    def matcher(self) -> ChosenMatcher:
        """The matcher; finding a GPU takes a second, which the first pictures do not wait for."""
        return choose_matcher(self.options.matcher, quick=True)

    @cached_property
    def shots(self) -> UndistortedSession:
        """The session's images, undistorted."""
        return UndistortedSession(self.dataset, self.motion, self.rig.views, self.options.multiview_width)

    def prepare(self) -> None:
        """Choose the cameras; see `ConditionStudy.prepare`.

        Raises:
            ValueError: fewer than three calibrated cameras have overlapping views, or the middle camera is
                not the one requested.
        """
        self.progress.step("choosing cameras for depth from all cameras")
        if not self.rig.views:
            raise ValueError("the cameras have no calibration")
        self.group = choose_camera_group(self.shots, self.context.middle)
        if self.middle_camera not in ("", self.group.reference):
            raise ValueError(f"its middle camera is {self.group.reference}, not {self.middle_camera}")

    def compare(self, condition: Condition, folder: Path | None = None) -> StudyResult[MultiviewFacts]:
        """Compare a condition with the synchronized one on the same instants, pixels and cameras.

        Writes pictures of the instant at which it found the most moving pixels into the folder.

        Raises:
            ValueError: the burst does not contain this condition.
        """
        instants = self._instants(condition)
        every = [(one, side) for one in instants for side in one.by_condition]

        def depth(at: tuple[ShownInstant, str], planes: Array) -> InstantDepth:
            one, side = at
            shown = one.by_condition[side]
            self.progress.step(f"depth from {len(shown)} cameras, instant {one.instant}, {side}")
            return self._depth(shown, planes)

        # The walls of a still scene are found once. The fusion of a cloud takes one core; the next depth
        # begins meanwhile.
        first = depth(every[0], NO_PLANES)
        with worker_pool(AT_A_TIME) as pool:
            later = pool.map(lambda at: depth(at, first.planes), every[1:])
            made = dict(zip([(one.instant, side) for one, side in every], [first, *later], strict=True))
        found = [{side: made[one.instant, side] for side in one.by_condition} for one in instants]
        nows = [one.instant for one in instants]
        scorer = InstantScorer(
            self.shots,
            self.group.reference,
            self.rig.unit,
            nows,
            [maps["synced"] for maps in found],
        )
        asked = nows, [one.shown for one in instants], found
        with worker_pool(AT_A_TIME) as pool:
            scores = list(pool.map(scorer.measure, *asked))
        tally = Tally()
        for one, measured in zip(instants, scores, strict=True):
            pixels = measured["synced"].shares["mover_coverage"][1]
            facts = {"instant": one.instant, "mover_pixels": pixels, **one.delays_ms(self.dataset)}
            tally.add(measured, facts)
        pictures, clouds = self._show(instants, found, scorer, folder) if folder else ((), None)
        group = self.group
        return StudyResult(
            name=self.text.name,
            cameras=group.cameras,
            instants=tally.instants,
            offsets_ms=relative_offsets_ms(condition, self.dataset, group.reference, group.cameras),
            measures=tally.measures,
            per_instant=tally.per_instant,
            pictures=pictures,
            facts=MultiviewFacts(
                reference=group.reference,
                tolerance_m=scorer.tolerance_m,
                width_px=self.shots.views[group.reference].width,
                matcher=self.matcher.name,
                matcher_note=self.matcher.note,
                clouds=clouds,
                left_out=dict(group.left_out),
                cloud_skipped=scorer.cloud_skipped,
            ),
        )

    def _instants(self, condition: Condition) -> list[ShownInstant]:
        """Return instants with motion at which most cameras have their images in both conditions."""
        reference, problem = self.group.reference, self.shots.problem
        complete = complete_instants(self.dataset, condition, reference, self.group.cameras)
        by_instant = {one.instant: one.shown for one in complete}
        found = []
        for now in choose_moving_instants(
            self.motion, (reference,), list(by_instant), self.options.multiview_instants
        ):
            shown = {c: k for c, k in by_instant[now].items() if not (problem(c, now) or problem(c, k))}
            if reference in shown and len(shown) >= MIN_CAMERAS:
                found.append(ShownInstant(now, shown))
        if not found:
            raise ValueError("no instant has its pictures in both conditions")
        return found

    def _depth(self, shown: dict[str, int], planes: Array) -> InstantDepth:
        shots = {camera: self.shots.image(camera, instant) for camera, instant in shown.items()}
        views = {camera: shot.calibrated.view for camera, shot in shots.items()}
        sources = choose_source_views(views, self.group.scene.points)
        if not sources[self.group.reference]:
            raise ValueError(f"no camera with a picture overlaps with {self.group.reference}")
        depth_ranges = {camera: self.group.scene.depth_ranges[camera] for camera in shown}
        reference = self.group.reference
        return self.rig.stages.arrays(
            "multiview",
            InstantDepth,
            lambda: compute_instant_depth(shots, sources, depth_ranges, reference, self.matcher, planes),
            reference,
            planes.tolist(),
            tuple(shown.items()),
            repr(views),
            tuple(depth_ranges.items()),
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
        """Write pictures and clouds of the instant with the most moving pixels found."""
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
        """Draw both clouds from six viewpoints; empty with too few points."""
        if len(maps["synced"].points) < MIN_POINTS:
            return ()
        clouds = {side: (found.points, found.colours) for side, found in maps.items()}
        views = [self.shots.image(camera, k).calibrated.view for camera, k in one.together.items()]
        drawn = draw_clouds(clouds, views)
        caption = "The points of all cameras, from six places."
        pictures = {side: {"multiview_turntable": picture} for side, picture in drawn.items()}
        return write_pictures(pictures, {"multiview_turntable": PictureText("All around", caption)}, folder)


def _draw_depth(
    photo: Array, maps: Mapping[str, InstantDepth], moving: Array, truth: Array | None, out: Path
) -> tuple[Picture, ...]:
    """Draw depth and motion (bool) of one instant in both conditions into out/pictures.

    `photo` (BGR) is the reference's undistorted image. `truth` is in the maps' unit, NaN = unknown.
    """
    near, far = display_range(maps["synced"].depth, moving)
    drawn = {}
    for side, found in maps.items():
        right = found.depth > 0
        if truth is not None:
            right &= right_depth(found.depth, truth)
        depth = colour_depth(found.depth, near, far)
        drawn[side] = {"multiview_depth": depth, "multiview_movers": mark_moving(photo, moving, right)}
    judged = f"it is right {TOLERANCE_TEXT}" if truth is not None else "the other cameras agree"
    distance = (
        "Bright is near, blue is far; dark means that no distance was found. On one side are the pictures "
        "that were recorded as one instant, on the other each camera is off by a different delay."
    )
    movers = f"Teal: a distance was found, and {judged}. Orange: none, or a wrong one."
    texts = {
        "multiview_depth": PictureText("Distance from all cameras", distance, flat=True),
        "multiview_movers": PictureText("What moves, by all cameras", movers),
    }
    return write_pictures(drawn, texts, out)
