"""Depth of the middle camera from all cameras, and the cloud fused from all."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Self

import msgspec
import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.exporting.point_cloud import PointCloud, write_ply
from reconstruction.common import wording
from reconstruction.common.drawing import colour_depth, display_range, mark_moving
from reconstruction.common.geometry import Array, View
from reconstruction.common.matchers import Matcher
from reconstruction.common.worker_pool import worker_pool
from reconstruction.depth.rough_scene import find_rough_scene
from reconstruction.depth.view_choice import choose_reference_view, choose_source_views
from reconstruction.method.score import UNASKED, Score
from reconstruction.method.study_result import Picture, StudyResult
from reconstruction.method.tally import CONDITIONS, Tally
from reconstruction.method.truth import TOLERANCE_TEXT, right_depth
from reconstruction.method.words import read_words
from reconstruction.methods.multiview.colmap_workspace import fuse_by_colmap
from reconstruction.methods.multiview.input_images import InputImages
from reconstruction.methods.multiview.instant_depth import InstantDepth
from reconstruction.methods.multiview.instant_scoring import InstantScorer
from reconstruction.methods.multiview.matcher import ChosenMatcher, choose_matcher, image_colours, image_views
from reconstruction.methods.multiview.mesh import draw_clouds
from reconstruction.methods.multiview.multiview_method import Multiview
from reconstruction.pages.embedding import InstantClouds, view_clouds
from reconstruction.scene.conditions import SYNCHRONIZED, Condition
from reconstruction.scene.instant_choice import (
    ShownInstant,
    complete_instants,
    relative_offsets_ms,
)

MIN_POINTS = 500
"""Minimum points of a synchronized cloud worth showing."""
MIN_CAMERAS = 3
"""Minimum number of cameras of a cloud that is compared."""
MAX_CAMERAS = 5
"""More cameras improve the cloud but say no more about timing; each takes as long as the first."""


def _require_cameras(cameras: Collection[str], left_out: Mapping[str, str]) -> None:
    if len(cameras) < MIN_CAMERAS:
        names = {why: ", ".join(c for c in left_out if left_out[c] == why) for why in left_out.values()}
        reasons = "".join(f"; {ours}: {why}" for why, ours in names.items())
        raise ValueError(f"it takes {MIN_CAMERAS} cameras with overlapping views{reasons}")


def save_clouds(
    instant: int, maps: Mapping[str, InstantDepth], depth: Array, view: View, moving: Array, out: Path
) -> InstantClouds:
    """Write the clouds that have points into out/pictures.

    `depth`, `view` and `moving` (bool) belong to the reference camera. A page starts from its position and
    rotates about the centre of the moving objects, else of all points.
    """
    clouds = {side: found.cloud for side, found in maps.items() if len(found.cloud.points)}
    paths = {side: f"pictures/cloud_{side}.ply" for side in clouds}
    for side, path in paths.items():
        write_ply(out / path, PointCloud(clouds[side].points, clouds[side].colours))
    known = depth > 0
    points = view.unproject_map(depth, known & moving if (known & moving).any() else known)
    return InstantClouds(
        instant=instant,
        **paths,
        rotation=tuple(view.rotation.ravel().tolist()),
        centre=tuple(view.centre.tolist()),
        focal=view.focal / view.width,
        pivot=tuple(np.median(points if len(points) else clouds["synced"].points, axis=0).tolist()),
    )


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


class MultiviewStudy(Score):
    """Depth from all cameras in any condition; synchronized images determine what all conditions share."""

    text = read_words(__package__)
    needs_calibration = True
    Options = Multiview

    @classmethod
    def placeholders(cls, found: StudyResult[MultiviewFacts]) -> dict[str, str]:
        """Return values for the names in braces; see `Score.placeholders`."""
        facts, tolerance_m = found.facts, found.facts.tolerance_m
        return super().placeholders(found) | {
            "reference": facts.reference,
            "near": "" if tolerance_m is None else f" to within {100 * tolerance_m:.3g}{wording.GAP}cm",
            "matcher": "COLMAP's PatchMatch on a GPU"
            if facts.matcher == Matcher.PATCHMATCH
            else "our own plane sweep, not by COLMAP",
            "width": f"{facts.width_px}",
        }

    @classmethod
    def view(cls, found: StudyResult[MultiviewFacts], heads: Mapping[str, str], out: Path) -> dict[str, Any]:
        """Return the cloud for the page's 3D view; see `Score.view`."""
        facts, number = found.facts, len(found.cameras)
        return {"cloud": facts.clouds and view_clouds(facts.clouds, out, facts.reference, number)}

    @classmethod
    def files(cls, found: StudyResult[MultiviewFacts]) -> dict[str, Sequence[str]]:
        """Return the paths of both clouds; see `Score.files`."""
        clouds = found.facts.clouds
        return {"the cloud of one instant in both": [clouds.synced, clouds.offset]} if clouds else {}

    middle_camera = ""
    """Required middle camera; any other is rejected. Empty accepts all."""

    @property
    def steps(self) -> int:
        """Number of progress lines: one for the choice of cameras, and one for each instant and condition."""
        limit: int = self.options.max_multiview_instants
        return 1 + 2 * min(limit, len(self.dataset.instants_ns)) if limit else 0

    def unasked(self) -> str:
        """Return a reason if the options allow the study no instants, else empty; see `Score.unasked`."""
        return "" if self.options.max_multiview_instants else UNASKED

    def check(self) -> None:
        """Reject a matcher that this machine cannot run; see `Score.check`."""
        if self.options.matcher.engine is not Matcher.SWEEP:
            self.matcher  # noqa: B018

    def adopt(self, ours: Self) -> None:
        """Use the middle camera of the comparison's own session."""
        self.middle_camera = ours.reference

    @cached_property
    def matcher(self) -> ChosenMatcher:
        """The matcher; finding a GPU takes a second, which the first pictures do not wait for."""
        return choose_matcher(self.options.matcher, quick=True)

    @cached_property
    def shots(self) -> InputImages:
        """The session's images, undistorted."""
        return InputImages(self.scene, self.options.multiview_width, self.motion)

    def prepare(self) -> None:
        """Choose the cameras; see `Score.prepare`.

        Raises:
            ValueError: fewer than three calibrated cameras have overlapping views, or the middle camera is
                not the one requested.
        """
        self.progress.step("choosing cameras for depth from all cameras")
        self._choose_cameras(self.context.middle)
        if self.middle_camera not in ("", self.reference):
            raise ValueError(f"its middle camera is {self.reference}, not {self.middle_camera}")

    def _choose_cameras(self, middle: int) -> None:
        """Choose the cameras from synchronized images around the instant `middle`.

        Sets `reference`, the central camera, on whose pixels depth is scored; `cameras`, with those whose
        views overlap most with it; `left_out`, the reasons for the others; and `scene`, a coarse first look.

        Raises:
            ValueError: fewer than `MIN_CAMERAS` have overlapping views.
        """
        shots, names, instants = self.shots, self.dataset.cameras, range(len(self.dataset.instants_ns))
        counts = {k: sum(self.dataset.has_image(c, k) for c in names) for k in instants}
        complete = sorted(instants, key=lambda k: (-counts[k], abs(k - middle)))[:4]
        best = max(complete, key=lambda k: sum(not shots.problem(c, k) for c in names))
        left_out = {c: problem for c in names if (problem := shots.problem(c, best))}
        images = {c: shots.image(c, best).calibrated for c in names if c not in left_out}
        _require_cameras(images, left_out)
        try:
            self.rough = find_rough_scene(images)
        except BadInputError as error:
            raise ValueError(error.what) from error
        points = self.rough.points
        sources = choose_source_views({c: image.view for c, image in images.items() if c in points}, points)
        views = {c: image.view for c, image in images.items() if len(sources.get(c, ())) > 1}
        left_out |= {c: "overlaps too little with any two others" for c in images if c not in views}
        _require_cameras(views, left_out)
        self.reference = choose_reference_view(views, points)
        nearest = [c for c in sources[self.reference] if c in views][: MAX_CAMERAS - 1]
        self.cameras = tuple(c for c in names if c == self.reference or c in nearest)
        self.left_out = left_out | {
            c: f"{MAX_CAMERAS} cameras are enough to compare conditions"
            for c in views
            if c not in self.cameras
        }
        _require_cameras(self.cameras, self.left_out)

    def compare(self, condition: Condition, folder: Path | None = None) -> StudyResult[MultiviewFacts]:
        """Compare a condition with the synchronized one on the same instants, pixels and cameras.

        Writes pictures of the instant at which it found the most moving pixels into the folder.

        Raises:
            ValueError: the burst does not contain this condition.
        """
        instants = self._instants(condition)
        late = condition.kept_at(self.reference)
        # Two conditions, and then two instants, are computed at a time.
        at_a_time = 2
        with worker_pool(at_a_time) as pool:
            synced, offset = pool.map(self._results, [instants] * 2, (SYNCHRONIZED, late), CONDITIONS)
        if not (
            instants := [moment for moment in instants if moment.instant in synced.keys() & offset.keys()]
        ):
            raise ValueError("no instant has depth in both conditions")
        nows = [moment.instant for moment in instants]
        found = [{"synced": synced[now], "offset": offset[now]} for now in nows]
        scorer = InstantScorer(
            self.shots, self.reference, self.scene.unit, nows, [maps["synced"] for maps in found]
        )
        tally = Tally()
        with worker_pool(at_a_time) as pool:
            scores = pool.map(scorer.measure, nows, [instant.shown for instant in instants], found)
            for one, measured in zip(instants, scores, strict=True):
                pixels = measured["synced"].shares["mover_coverage"][1]
                delays = one.delays_ms(self.dataset)
                tally.add(measured, {"instant": one.instant, "mover_pixels": pixels, **delays})
        pictures, clouds = self._show(instants, found, scorer, folder) if folder else ((), None)
        return StudyResult(
            name=self.text.name,
            cameras=self.cameras,
            instants=tally.instants,
            offsets_ms=relative_offsets_ms(condition, self.dataset, self.reference, self.cameras),
            commands=self.commands(self.method(instants), late),
            measures=tally.measures,
            per_instant=tally.per_instant,
            pictures=pictures,
            facts=MultiviewFacts(
                reference=self.reference,
                tolerance_m=scorer.tolerance_m,
                width_px=self.shots.views[self.reference].width,
                matcher=self.matcher.name,
                matcher_note=self.matcher.note,
                clouds=clouds,
                left_out=self.left_out,
            ),
        )

    def _instants(self, condition: Condition) -> list[ShownInstant]:
        """Return instants with motion at which most cameras have their images in both conditions."""
        reference, problem = self.reference, self.shots.problem
        complete = complete_instants(self.dataset, condition, reference, self.cameras)
        chosen = self.moving_moments(complete, (reference,), self.options.max_multiview_instants)
        usable = {
            one.instant: {
                c: own for c, own in one.shown.items() if not (problem(c, one.instant) or problem(c, own))
            }
            for one in chosen
        }
        # A run has the same cameras at all instants.
        groups = Counter(frozenset(shown) for shown in usable.values() if reference in shown)
        best = max(groups, key=lambda group: (groups[group], len(group)), default=frozenset())
        if len(best) >= MIN_CAMERAS:
            return [
                ShownInstant(k, {c: shown[c] for c in shown if c in best})
                for k, shown in usable.items()
                if best <= shown.keys()
            ]
        raise ValueError("no instant has its pictures in both conditions")

    def method(self, instants: Sequence[ShownInstant]) -> Multiview:
        """Return the method whose results are scored, with the options of its command."""
        options: Multiview = self.options
        return msgspec.structs.replace(
            options,
            instants=tuple(moment.instant for moment in instants),
            without=tuple(c for c in self.dataset.cameras if c not in instants[0].shown),
            width=self.options.multiview_width,
            quick=True,
            depth=True,
        )

    def _results(
        self, instants: Sequence[ShownInstant], condition: Condition, side: str
    ) -> dict[int, InstantDepth]:
        """Run the method under a condition, once in a comparison; return what its files would hold."""
        method = self.method(instants)

        def run() -> dict[int, InstantDepth]:
            results = {}
            with suppress(BadInputError):  # no instant has depth
                for result in method.run(self.scene, condition):
                    self.progress.step(
                        f"depth from {len(result.maps)} cameras, instant {result.instant}, {side}"
                    )
                    if self.reference in result.maps:
                        results[result.instant] = InstantDepth.of(result)
            return results

        return self.scene.once(("multiview", method.instants, method.without, condition), run)

    def _show(
        self,
        instants: list[ShownInstant],
        found: list[dict[str, InstantDepth]],
        scorer: InstantScorer,
        folder: Path,
    ) -> tuple[tuple[Picture, ...], InstantClouds | None]:
        """Write pictures and clouds of the instant with the most moving pixels found."""
        reference = self.reference
        moving = [self.shots.moving(reference, moment.instant) for moment in instants]
        depth = [{side: one.maps[reference].depth for side, one in maps.items()} for maps in found]
        best = max(range(len(found)), key=lambda k: (moving[k] & (depth[k]["synced"] > 0)).sum())
        one, mask, maps = instants[best], moving[best], found[best]
        shot = self.shots.image(reference, one.instant)
        truth = scorer.true_depth(one.instant)
        judged = "the other cameras agree" if truth is None else f"it is right {TOLERANCE_TEXT}"
        pictures = self.write_pictures(
            _draw_depth(shot.colours, depth[best], mask, truth), folder, flat="multiview_depth", judged=judged
        )
        if len(maps["synced"].cloud.points) < MIN_POINTS:
            return pictures, None
        clouds = {side: (of.cloud.points, of.cloud.colours) for side, of in maps.items()}
        places = [self.shots.plain_views[camera] for camera in one.shown]
        drawn = {
            side: {"multiview_turntable": picture} for side, picture in draw_clouds(clouds, places).items()
        }
        pictures += self.write_pictures(drawn, folder)
        pictures += self._show_by_colmap(one, maps, places, folder)
        return pictures, save_clouds(
            one.instant, maps, depth[best]["synced"], shot.calibrated.view, mask, folder
        )

    def _show_by_colmap(
        self, one: ShownInstant, maps: Mapping[str, InstantDepth], places: Sequence[View], folder: Path
    ) -> tuple[Picture, ...]:
        """Draw the same maps fused by COLMAP, from the same places; nothing where pycolmap is missing."""
        if find_spec("pycolmap") is None:
            return ()
        clouds = {}
        for side, shown in one.by_condition.items():
            depths = maps[side].maps
            shots = {camera: self.shots.image(camera, k) for camera, k in shown.items() if camera in depths}
            views, colours = image_views(shots), image_colours(shots)
            clouds[side] = fuse_by_colmap(views, colours, depths, min(MIN_CAMERAS, len(views)))
        if len(clouds["synced"][0]) < MIN_POINTS:
            return ()
        drawn = {side: {"multiview_colmap": picture} for side, picture in draw_clouds(clouds, places).items()}
        return self.write_pictures(drawn, folder)


def _draw_depth(
    photo: Array, maps: Mapping[str, Array], moving: Array, truth: Array | None
) -> dict[str, dict[str, Array]]:
    """Draw depth and motion (bool) of one instant in both conditions.

    `photo` (BGR) is the reference's undistorted image. `truth` is in the maps' unit, NaN = unknown.
    """
    limits = display_range(maps["synced"], moving)
    drawn = {}
    for side, found in maps.items():
        right = found > 0 if truth is None else (found > 0) & right_depth(found, truth)
        drawn[side] = {
            "multiview_depth": colour_depth(found, *limits),
            "multiview_movers": mark_moving(photo, moving, right),
        }
    return drawn
