"""The multi-view study of a comparison: depth of the middle camera from all, and the cloud fused from all."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np

from capture_app.errors import BadInputError
from capture_app.terminal import Progress
from reconstruction.calibration.rig import Rig
from reconstruction.common.native_libraries import library_versions
from reconstruction.compare.study import ALL_APART, SIDES, ComparisonTally
from reconstruction.depth.depth_range import find_depth_range
from reconstruction.multiview.comparison_pictures import multiview_pictures
from reconstruction.multiview.instant_depth import InstantDepth, instant_depth
from reconstruction.multiview.instant_scoring import InstantScorer
from reconstruction.multiview.source_views import choose_reference_view, choose_source_views, guess_depths
from reconstruction.multiview.undistorted_session import UndistortedSession
from reconstruction.scores.depth_results import MultiviewComparison, MultiviewScores
from reconstruction.scores.results import Picture
from reconstruction.scores.tally import Measurements
from reconstruction.session.conditions import Condition
from reconstruction.session.frame_offset import evenly_spread
from reconstruction.session.shown_instants import fixed_offsets_ms, instants_shown, refuse_synchronized

FEWEST_CAMERAS = 3
MOST_CAMERAS = 5
"""More cameras make better clouds, but say no more about timing; each takes as long as the first."""
TRIES = 4
"""Instants tried to find one at which every camera has a usable picture."""
PER_INSTANT = (
    "mover_coverage", "static_coverage", "mover_within_2pct", "static_within_2pct", "mover_consistency",
    "mover_points",
)  # fmt: skip


@dataclass(frozen=True)
class ShownInstant:
    """What each camera shows at one instant of the reference: in the condition, and all of one instant."""

    instant: int
    shown: dict[str, int]

    @property
    def together(self) -> dict[str, int]:
        """The synchronized condition."""
        return dict.fromkeys(self.shown, self.instant)


class MultiviewStudy:
    """Depth from all cameras in any condition; what is fixed for all comes from synchronized pictures."""

    subject = "depth from all cameras"
    condition = ALL_APART

    def __init__(
        self,
        rig: Rig,
        most_instants: int,
        width: int,
        reference: str = "",
        match: Callable[..., InstantDepth] = instant_depth,
    ) -> None:
        """Pictures wider than `width` px are made smaller; `reference`: refuse any other middle camera.

        `match` makes the depth of an instant, as `instant_depth` does.
        """
        self.rig = rig
        self.dataset = rig.dataset
        self.most_instants = most_instants
        self.width = width
        self.reference = reference
        self.match = match
        self.cameras: tuple[str, ...] = ()
        self.depth_range = (0.0, 0.0)
        self.left_out: dict[str, str] = {}

    @property
    def steps(self) -> int:
        """A line to begin with, and one for each instant and condition."""
        return 1 + 2 * min(self.most_instants, len(self.dataset.instants_ns))

    def for_session(self, rig: Rig) -> Self:
        """The same middle camera of another session."""
        return type(self)(rig, self.most_instants, self.width, self.reference, self.match)

    @cached_property
    def shots(self) -> UndistortedSession:
        """The session's pictures, undistorted."""
        return UndistortedSession(self.dataset, self.rig.motion, self.rig.views, self.width)

    def prepare(self, middle: int, progress: Progress) -> None:
        """Fix the cameras, the middle one and the depth range, from pictures around an instant.

        Raises:
            ValueError: fewer than three cameras see the same.
        """
        progress.step("choosing cameras for depth from all cameras")
        if not self.rig.views:
            raise ValueError("the cameras have no calibration")
        names, every = self.dataset.cameras, range(len(self.dataset.instants_ns))
        there = {k: sum(self.dataset.has_image(c, k) for c in names) for k in every}
        first = sorted(every, key=lambda k: (-there[k], abs(k - middle)))[:TRIES]
        best = max(first, key=lambda k: sum(self.shots.usable(c, k) for c in names))
        problems = {c: self.shots.problem(c, best) for c in names}
        self.left_out = {c: problem for c, problem in problems.items() if problem}
        photos = {c: self.shots.image(c, best).calibrated for c in names if c not in self.left_out}
        self._need(len(photos))
        views = {camera: photo.view for camera, photo in photos.items()}
        try:
            self.depth_range = find_depth_range(photos, choose_source_views(views, guess_depths(views)))
        except BadInputError as error:
            raise ValueError(error.what) from error
        depths = self._depths
        sources = choose_source_views(views, depths)
        alone = {c: "overlaps too little with any two others" for c in photos if len(sources[c]) < 2}
        views = {c: view for c, view in views.items() if c not in alone}
        self.left_out |= alone
        self._need(len(views))
        found = choose_reference_view(views, depths)
        if self.reference not in ("", found):
            raise ValueError(f"its middle camera is {found}, not {self.reference}")
        self.reference = found
        near = [c for c in sources[self.reference] if c in views][: MOST_CAMERAS - 1]
        self.cameras = tuple(c for c in names if c == self.reference or c in near)
        for camera in views:
            if camera not in self.cameras:
                self.left_out[camera] = f"{MOST_CAMERAS} cameras are enough to compare conditions"
        self._need(len(self.cameras))

    def compare(
        self, condition: Condition, progress: Progress, folder: Path | None = None
    ) -> MultiviewComparison:
        """A condition against the synchronized one, on the same instants, pixels and cameras.

        Pictures of the instant with most to see are made where there is a folder.

        Raises:
            ValueError: the burst does not hold this condition.
        """
        instants = self._instants(condition)
        found = []
        for one in instants:
            maps = {}
            for side, shown in zip(SIDES, (one.together, one.shown), strict=True):
                progress.step(f"depth from {len(shown)} cameras, instant {one.instant}, {side}")
                maps[side] = self._depth(shown)
            found.append(maps)
        scorer = InstantScorer(
            self.shots,
            self.reference,
            self.rig.unit,
            [one.instant for one in instants],
            [maps["synced"] for maps in found],
        )
        tally = ComparisonTally(MultiviewScores, PER_INSTANT)
        for one, maps in zip(instants, found, strict=True):
            measured = scorer.measure(one.instant, one.shown, maps)
            tally.add(measured, self._facts(one, measured["synced"]))
        return MultiviewComparison(
            reference=self.reference,
            cameras=self.cameras,
            synced=tally.synced,
            offset=tally.offset,
            offsets_ms=self._late(condition),
            tolerance_m=scorer.tolerance_m,
            width_px=self.shots.views[self.reference].width,
            per_instant=tally.per_instant,
            differences=tally.differences,
            pictures=self._pictures(instants, found, scorer, folder) if folder else (),
            left_out=self.left_out,
            cloud_skipped=scorer.cloud_skipped,
        )

    def _instants(self, condition: Condition) -> list[ShownInstant]:
        """The instants at which most cameras have their pictures in both conditions, thinned."""
        found: list[ShownInstant] = []
        problem = "no instant has its pictures in both conditions"
        for instant in self.dataset.instants(self.reference):
            try:
                shown = instants_shown(self.dataset, condition, self.reference, instant)
            except ValueError as error:
                problem = str(error)
                continue
            found.append(ShownInstant(instant, self._kept(instant, shown, self.dataset.has_image)))
        if not found:
            raise ValueError(problem)
        most = max(len(one.shown) for one in found)
        fullest = [one for one in found if len(one.shown) == most]
        refuse_synchronized(condition, [(one.instant, one.shown) for one in fullest])
        chosen = evenly_spread(fullest, self.most_instants)
        usable = [(one.instant, self._kept(one.instant, one.shown, self.shots.usable)) for one in chosen]
        useful = [
            ShownInstant(instant, shown)
            for instant, shown in usable
            if self.reference in shown and len(shown) >= FEWEST_CAMERAS
        ]
        if not useful:
            raise ValueError(problem)
        return useful

    def _kept(self, instant: int, shown: dict[str, int], good: Callable[[str, int], bool]) -> dict[str, int]:
        """The cameras whose pictures are good in both conditions, and what they show."""
        return {c: shown[c] for c in self.cameras if c in shown and good(c, instant) and good(c, shown[c])}

    def _depth(self, shown: dict[str, int]) -> InstantDepth:
        shots = {camera: self.shots.image(camera, instant) for camera, instant in shown.items()}
        views = {camera: shot.calibrated.view for camera, shot in shots.items()}
        sources = choose_source_views(views, self._depths)
        if not sources[self.reference]:
            raise ValueError(f"no camera with a picture sees what {self.reference} sees")
        made = self.rig.stages.arrays(
            "multiview",
            lambda: vars(self.match(shots, sources, self.depth_range, self.reference)),
            self.reference,
            tuple(shown.items()),
            repr(views),
            self.depth_range,
            library_versions()["pycolmap"],
        )
        return InstantDepth(**made)

    def _facts(self, one: ShownInstant, synced: Measurements) -> dict[str, float | int | None]:
        times = self.dataset.instants_ns
        return {
            "instant": one.instant,
            "mover_pixels": synced.shares["mover_coverage"][1],
            **{f"offset_{c}_ms": (times[k] - times[one.instant]) / 1e6 for c, k in one.shown.items()},
        }

    def _pictures(
        self,
        instants: list[ShownInstant],
        found: list[dict[str, InstantDepth]],
        scorer: InstantScorer,
        folder: Path,
    ) -> tuple[Picture, ...]:
        moving = [self.shots.moving(self.reference, one.instant) for one in instants]
        seen = [
            int((mask & (maps["synced"].depth > 0)).sum()) for mask, maps in zip(moving, found, strict=True)
        ]
        best = int(np.argmax(seen))
        instant = instants[best].instant
        photo = self.shots.image(self.reference, instant).colours
        return multiview_pictures(photo, found[best], moving[best], scorer.true_depth(instant), folder)

    def _late(self, condition: Condition) -> dict[str, float]:
        late_ms = fixed_offsets_ms(condition, self.dataset)
        return {c: late_ms[c] - late_ms[self.reference] for c in self.cameras} if late_ms else {}

    @property
    def _depths(self) -> tuple[float, float, float]:
        nearest, farthest = self.depth_range
        return nearest, 2 / (1 / nearest + 1 / farthest), farthest

    def _need(self, cameras: int) -> None:
        if cameras < FEWEST_CAMERAS:
            told = [f"it takes {FEWEST_CAMERAS} cameras with overlapping views"]
            for why in dict.fromkeys(self.left_out.values()):
                told.append(f"{', '.join(c for c, its in self.left_out.items() if its == why)}: {why}")
            raise ValueError("; ".join(told))
