"""The part of a comparison that takes all cameras: depth of the middle one, and the cloud of them all."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from capture_app.errors import BadInputError
from capture_app.terminal import Progress
from reconstruction.common.native_libraries import library_versions
from reconstruction.common.stage_cache import StageCache
from reconstruction.depth.depth_range import find_depth_range
from reconstruction.multiview.comparison_pictures import multiview_pictures
from reconstruction.multiview.instant_depth import InstantDepth, instant_depth
from reconstruction.multiview.instant_scoring import InstantScorer
from reconstruction.multiview.source_views import choose_reference_view, choose_source_views, guess_depths
from reconstruction.multiview.undistorted_session import UndistortedSession
from reconstruction.scores.depth_results import MultiviewComparison, MultiviewScores
from reconstruction.scores.results import Picture
from reconstruction.scores.tally import Measurements, Tally, differences
from reconstruction.session.conditions import Condition
from reconstruction.session.dataset import Dataset
from reconstruction.session.frame_offset import evenly_spread
from reconstruction.session.shown_instants import fixed_offsets_ms, instants_shown, refuse_synchronized

FEWEST_CAMERAS = 3
MOST_CAMERAS = 5
"""More cameras make better clouds, but say no more about timing; each takes as long as the first."""
TRIES = 4
"""Instants that are looked at for one at which every camera shows something."""
CONDITIONS = ("synced", "offset")
ROW = (
    "mover_coverage", "static_coverage", "mover_within_2pct", "static_within_2pct", "mover_consistency",
    "mover_points",
)  # fmt: skip
"""What is told of every single instant."""


@dataclass(frozen=True)
class Taken:
    """What each camera shows at one instant of the reference: in the condition, and all of one instant."""

    instant: int
    shown: dict[str, int]

    @property
    def together(self) -> dict[str, int]:
        """The synchronized condition."""
        return dict.fromkeys(self.shown, self.instant)


class MultiviewStudy:
    """Depth from all cameras in any condition; what is fixed for all comes from synchronized pictures."""

    def __init__(self, shots: UndistortedSession, stages: StageCache, unit: str, most_instants: int) -> None:
        """`unit` is the calibration's unit of length."""
        self.shots = shots
        self.stages = stages
        self.unit = unit
        self.most_instants = most_instants
        self.cameras: tuple[str, ...] = ()
        self.reference = ""
        self.reach = (0.0, 0.0)
        self.left_out: dict[str, str] = {}

    @property
    def dataset(self) -> Dataset:
        """The session."""
        return self.shots.dataset

    def prepare(self, instant: int) -> None:
        """Fix the cameras, the middle one and the depth range, from pictures around an instant.

        Raises:
            ValueError: fewer than three cameras see the same.
        """
        names, every = self.dataset.cameras, range(len(self.dataset.instants_ns))
        there = {k: sum(self.dataset.has_image(c, k) for c in names) for k in every}
        first = sorted(every, key=lambda k: (-there[k], abs(k - instant)))[:TRIES]
        best = max(first, key=lambda k: sum(self.shots.usable(c, k) for c in names))
        problems = {c: self.shots.problem(c, best) for c in names}
        self.left_out = {c: problem for c, problem in problems.items() if problem}
        photos = {c: self.shots.image(c, best).calibrated for c in names if c not in self.left_out}
        self._need(len(photos))
        views = {camera: photo.view for camera, photo in photos.items()}
        try:
            self.reach = find_depth_range(photos, choose_source_views(views, guess_depths(views)))
        except BadInputError as error:
            raise ValueError(error.what) from error
        depths = self._depths
        sources = choose_source_views(views, depths)
        alone = {c: "shares too little with any two others" for c in photos if len(sources[c]) < 2}
        views = {c: view for c, view in views.items() if c not in alone}
        self.left_out |= alone
        self._need(len(views))
        self.reference = choose_reference_view(views, depths)
        near = [c for c in sources[self.reference] if c in views][: MOST_CAMERAS - 1]
        self.cameras = tuple(c for c in names if c == self.reference or c in near)
        for camera in views:
            if camera not in self.cameras:
                self.left_out[camera] = f"{MOST_CAMERAS} are enough to compare conditions"
        self._need(len(self.cameras))

    def compare(
        self, condition: Condition, progress: Progress, folder: Path | None = None
    ) -> MultiviewComparison:
        """A condition against the synchronized one, on the same instants, pixels and cameras.

        Pictures of the instant with most to see are made where there is a folder.

        Raises:
            ValueError: the burst does not hold this condition.
        """
        taken = self._taken(condition)
        found = []
        for one in taken:
            maps = {}
            for name, shown in zip(CONDITIONS, (one.together, one.shown), strict=True):
                progress.step(f"depth from {len(shown)} cameras, instant {one.instant}, {name}")
                maps[name] = self._depth(shown)
            found.append(maps)
        instants = [one.instant for one in taken]
        judge = InstantScorer(
            self.shots, self.reference, self.unit, instants, [maps["synced"] for maps in found]
        )
        tallies = {name: Tally() for name in CONDITIONS}
        rows = []
        for one, maps in zip(taken, found, strict=True):
            counts = judge.measure(one.instant, one.shown, maps)
            rows.append(self._row(one, counts))
            for name, measured in counts.items():
                tallies[name].add(measured)
        return MultiviewComparison(
            reference=self.reference,
            cameras=self.cameras,
            synced=tallies["synced"].scores(MultiviewScores),
            offset=tallies["offset"].scores(MultiviewScores),
            offsets_ms=self._late(condition),
            tolerance_m=judge.tolerance_m,
            width_px=self.shots.views[self.reference].width,
            per_instant=tuple(rows),
            differences=differences(tallies["synced"], tallies["offset"], MultiviewScores),
            pictures=self._pictures(taken, found, judge, folder) if folder else (),
            left_out=self.left_out,
            cloud_skipped=judge.cloud_skipped,
        )

    def _taken(self, condition: Condition) -> list[Taken]:
        """The instants at which most cameras have their pictures in both conditions, thinned."""
        found: list[Taken] = []
        problem = "no instant has its pictures in both conditions"
        for instant in self.dataset.instants(self.reference):
            try:
                shown = instants_shown(self.dataset, condition, self.reference, instant)
            except ValueError as error:
                problem = str(error)
                continue
            found.append(Taken(instant, self._kept(instant, shown, self.dataset.has_image)))
        if not found:
            raise ValueError(problem)
        most = max(len(one.shown) for one in found)
        fullest = [one for one in found if len(one.shown) == most]
        refuse_synchronized(condition, [(one.instant, one.shown) for one in fullest])
        places = evenly_spread([(place, place) for place in range(len(fullest))], self.most_instants)
        chosen = [fullest[place] for place, _ in places]
        shown_only = [Taken(o.instant, self._kept(o.instant, o.shown, self.shots.usable)) for o in chosen]
        useful = [o for o in shown_only if self.reference in o.shown and len(o.shown) >= FEWEST_CAMERAS]
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
        made = self.stages.arrays(
            "multiview",
            lambda: vars(instant_depth(shots, sources, self.reach, self.reference)),
            self.reference,
            tuple(shown.items()),
            repr(views),
            self.reach,
            library_versions()["pycolmap"],
        )
        return InstantDepth(**made)

    def _row(self, one: Taken, counts: dict[str, Measurements]) -> dict[str, float | int | None]:
        row: dict[str, float | int | None] = {
            "instant": one.instant,
            "mover_pixels": counts["synced"].shares["mover_coverage"][1],
        }
        for name, measured in counts.items():
            row |= {f"{name}_{measure}": Tally([measured]).value(measure) for measure in ROW}
        times = self.dataset.instants_ns
        for camera, instant in one.shown.items():
            row[f"late_{camera}_ms"] = (times[instant] - times[one.instant]) / 1e6
        return row

    def _pictures(
        self, taken: list[Taken], found: list[dict[str, InstantDepth]], judge: InstantScorer, folder: Path
    ) -> tuple[Picture, ...]:
        moving = [self.shots.moving(self.reference, one.instant) for one in taken]
        seen = [
            int((mask & (maps["synced"].depth > 0)).sum()) for mask, maps in zip(moving, found, strict=True)
        ]
        best = int(np.argmax(seen))
        instant = taken[best].instant
        photo = self.shots.image(self.reference, instant).colours
        return multiview_pictures(photo, found[best], moving[best], judge.true_depth(instant), folder)

    def _late(self, condition: Condition) -> dict[str, float]:
        late_ms = fixed_offsets_ms(condition, self.dataset)
        return {c: late_ms[c] - late_ms[self.reference] for c in self.cameras} if late_ms else {}

    @property
    def _depths(self) -> tuple[float, float, float]:
        nearest, farthest = self.reach
        return nearest, 2 / (1 / nearest + 1 / farthest), farthest

    def _need(self, cameras: int) -> None:
        if cameras < FEWEST_CAMERAS:
            told = [f"it takes {FEWEST_CAMERAS} cameras that see the same"]
            for why in dict.fromkeys(self.left_out.values()):
                told.append(f"{', '.join(c for c, its in self.left_out.items() if its == why)}: {why}")
            raise ValueError("; ".join(told))
