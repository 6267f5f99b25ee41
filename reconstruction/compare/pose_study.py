"""The part of a comparison that finds the cameras' poses instant by instant, as it must where all moves."""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from reconstruction.common.geometry import View
from reconstruction.common.native_libraries import library_versions
from reconstruction.common.stage_cache import StageCache
from reconstruction.poses.pose_errors import relative_pose_errors
from reconstruction.poses.pose_finder import PoseFinder
from reconstruction.scores.pose_results import PoseComparison, PoseScores
from reconstruction.scores.tally import Measurements, Tally, differences, measures_of
from reconstruction.session.conditions import Condition
from reconstruction.session.dataset import Dataset
from reconstruction.session.frame_offset import evenly_spread
from reconstruction.session.shown_instants import fixed_offsets_ms, instants_shown, refuse_synchronized

RIGHT_DEG = 2.0
HARMED = 0.1
LARGE_MOVING_SHARE = 0.2
"""Less than this of the picture moving is thrown out with the outliers: poses are as good when late."""
MOST_INSTANTS = 5


@dataclass(frozen=True)
class Placed:
    """One instant's result: cameras that were placed, and the two errors (degrees) of each two of them."""

    cameras: int
    registered: int
    errors: tuple[tuple[float, float], ...]

    @property
    def pairs(self) -> int:
        """How many pairs the cameras make."""
        return self.cameras * (self.cameras - 1) // 2

    @property
    def right(self) -> int:
        """How many of them were placed right."""
        return sum(max(error) <= RIGHT_DEG for error in self.errors)


class PoseStudy:
    """Poses of single instants, held against the calibration, in any condition."""

    def __init__(self, dataset: Dataset, views: Mapping[str, View], stages: StageCache, truth: str) -> None:
        """`truth` says in words where the calibration came from."""
        self.dataset = dataset
        self.views = views
        self.stages = stages
        self.truth = truth
        self.cameras = tuple(name for name in dataset.cameras if name in views)

    def compare(self, condition: Condition, why: str) -> PoseComparison:
        """A condition against the synchronized one, on the same instants.

        Raises:
            ValueError: fewer than three cameras are calibrated, or the burst does not hold the condition.
            NotAvailableError: COLMAP is not installed here.
        """
        if len(self.cameras) < 3:
            raise ValueError("it takes three cameras to tell a wrong pose from another scale")
        taken = self._taken(condition)
        found: dict[str, list[Placed]] = {"synced": [], "offset": []}
        with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
            finder = _Lazy(self, Path(scratch))
            for instant, shown in taken:
                together = dict.fromkeys(self.cameras, instant)
                for name, pictures in (("synced", together), ("offset", shown)):
                    found[name].append(self._placed(finder, pictures))
        late_ms = fixed_offsets_ms(condition, self.dataset)
        first = self.cameras[0]
        before, after = (Tally(map(_measurements, found[name])) for name in ("synced", "offset"))
        synced, offset = before.scores(PoseScores), after.scores(PoseScores)
        return PoseComparison(
            cameras=self.cameras,
            synced=synced,
            offset=offset,
            harmed=synced.right_pairs - offset.right_pairs > HARMED,
            right_deg=RIGHT_DEG,
            truth=self.truth,
            offsets_ms={c: late_ms[c] - late_ms[first] for c in self.cameras} if late_ms else {},
            per_instant=tuple(
                {"instant": instant, **_row("synced", synced_one), **_row("offset", offset_one)}
                for (instant, _), synced_one, offset_one in zip(taken, *found.values(), strict=True)
            ),
            differences=differences(before, after, PoseScores),
            why=why,
        )

    def _taken(self, condition: Condition) -> list[tuple[int, dict[str, int]]]:
        found = []
        problem = "no instant has all its pictures in both conditions"
        for instant in range(len(self.dataset.instants_ns)):
            try:
                shown = instants_shown(self.dataset, condition, self.cameras[0], instant)
            except ValueError as error:
                problem = str(error)
                continue
            shown = {camera: shown[camera] for camera in self.cameras}
            if self.dataset.has_images((c, k) for c, late in shown.items() for k in (instant, late)):
                found.append((instant, shown))
        if not found:
            raise ValueError(problem)
        refuse_synchronized(condition, found)
        chosen = evenly_spread([(place, place) for place in range(len(found))], MOST_INSTANTS)
        return [found[place] for place, _ in chosen]

    def _placed(self, finder: "_Lazy", shown: dict[str, int]) -> Placed:
        def make() -> Placed:
            poses = finder.get().find_poses(shown)
            true = {name: (view.rotation, view.translation) for name, view in self.views.items()}
            return Placed(len(shown), len(poses), tuple(relative_pose_errors(poses, true)))

        version = library_versions()["pycolmap"]
        return self.stages.record("poses", Placed, make, tuple(shown.items()), repr(self.views), version)


class _Lazy:
    """A finder that is made when a result is not there already."""

    def __init__(self, study: PoseStudy, folder: Path) -> None:
        self._study = study
        self._folder = folder
        self._finder: PoseFinder | None = None

    def get(self) -> PoseFinder:
        if self._finder is None:
            self._finder = PoseFinder(self._study.dataset, self._study.views, self._folder)
        return self._finder


def _measurements(one: Placed) -> Measurements:
    rotations, directions = (np.array([error[which] for error in one.errors]) for which in (0, 1))
    return Measurements(
        shares={"right_pairs": (one.right, one.pairs)},
        medians={"rotation_deg": rotations, "direction_deg": directions},
        means={"registered": np.array([float(one.registered)])},
    )


def _row(name: str, one: Placed) -> dict[str, float | int | None]:
    tally = Tally([_measurements(one)])
    return {f"{name}_{measure}": tally.value(measure) for measure in measures_of(PoseScores)}
