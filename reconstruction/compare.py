"""`reconstruct compare`: what synchronization does to depth and to a panorama, on one burst."""

import time
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from capture_app.errors import BadInputError, NotAvailableError
from capture_app.session.calibration import Calibration
from reconstruction.calibration import find_calibration, views_of
from reconstruction.dataset import Dataset
from reconstruction.depth_study import DepthStudy
from reconstruction.features import Points, find_points
from reconstruction.geometry import View
from reconstruction.movers import grow
from reconstruction.native import versions
from reconstruction.output import Output
from reconstruction.pairs import Choice, choose_panorama, choose_stereo
from reconstruction.panorama_study import PanoramaStudy
from reconstruction.pipeline import Progress, Stages
from reconstruction.report import write_report
from reconstruction.results import CompareResult, Picture, StereoResult, StitchResult
from reconstruction.scene_motion import SceneMotion
from reconstruction.variants import Offset, choose_offset, thin, usable_pairs
from reconstruction.verdict import verdict


@dataclass(frozen=True, kw_only=True)
class CompareOptions:
    """What can be asked for; pairs are names of cameras, None = chosen from the images."""

    offset_ms: float = 66.0
    stereo: tuple[str, str] | None = None
    stitch: tuple[str, str] | None = None
    most_instants: int = 16


def compare(session: Path, out: Path, options: CompareOptions) -> CompareResult:
    """Compare a session with itself, one camera offset; write metrics, pictures and the report to `out`.

    The folder appears whole or not at all.

    Raises:
        SimulshotError: the session, the options or the folder cannot be used.
    """
    began = time.monotonic()
    dataset = Dataset.open(session)
    offset = choose_offset(dataset.instants_ns, dataset.period_ns, options.offset_ms)
    for pair in (options.stereo, options.stitch):
        _check_pair(dataset, pair)
    with Output(out) as output:
        result = _Comparison(dataset, offset, options, output.folder).run(session)
        result = msgspec.structs.replace(result, report="report.html", seconds=time.monotonic() - began)
        write_report(result, output.folder)
        output.finish(result)
    return result


def _check_pair(dataset: Dataset, pair: tuple[str, str] | None) -> None:
    for name in pair or ():
        dataset.session.camera(name)
    if pair is not None and pair[0] == pair[1]:
        raise BadInputError(f"{pair[0]} cannot be paired with itself", hint="name two cameras")


class _Comparison:
    """One run, from an opened session to a result without its report."""

    def __init__(self, dataset: Dataset, offset: Offset, options: CompareOptions, folder: Path) -> None:
        self.dataset = dataset
        self.offset = offset
        self.options = options
        self.folder = folder
        self.stages = Stages(folder / "stages", dataset.fingerprint())
        self.motion = SceneMotion(dataset, offset.step)
        each = 1 + min(len(offset.pairs), options.most_instants)
        self.progress = Progress(3 + each + each + 1)
        self.views: dict[str, View] = {}
        self.calibration: Calibration | None = None
        self.pictures: list[Picture] = []

    def run(self, session: Path) -> CompareResult:
        """Everything in turn; a half that is impossible is skipped with its reason."""
        self.progress.step(f"what moves in {self.dataset.name}")
        moving = self._moving_share()
        self.progress.step("calibration")
        no_views = self._calibrate()
        self.progress.step("choosing cameras")
        points = self._points()
        stereo, stereo_skipped = self._stereo(points, no_views)
        stitched, stitch_skipped = self._stitch(points)
        if stereo is None and stitched is None and isinstance(no_views, NotAvailableError):
            raise no_views
        self.progress.last("report")
        return CompareResult(
            session=str(session),
            offset_ms=self.offset.asked_ms,
            offset_frames=self.offset.frames,
            actual_offset_ms=self.offset.actual_ms,
            verdict=verdict(stereo, stitched, self.offset.actual_ms, moving),
            calibration=self.calibration.source or "the session's own" if self.calibration else "none",
            stereo=stereo,
            stitch=stitched,
            stereo_skipped=stereo_skipped,
            stitch_skipped=stitch_skipped,
            sync_residual_us=self.dataset.residual_us(),
            sync_bound_us=self.dataset.bound_us(),
            pictures=tuple(self.pictures),
            versions=versions(),
        )

    def _moving_share(self) -> float:
        """Largest share of any camera's pixels that move, the mean over its instants."""
        shares = [0.0]
        for name in self.dataset.cameras:
            instants = [k for k, _ in thin(self.offset.pairs, 4) if self.dataset.has(name, k)]
            if instants:
                shares.append(float(np.mean([self.motion.seen_moving(name, k).mean() for k in instants])))
        return max(shares)

    def _calibrate(self) -> NotAvailableError | BadInputError | None:
        """Set the views; the error says why there are none."""
        own = self.dataset.calibration()
        try:
            self.calibration = own or self.stages.record("calibration", Calibration, self._solve)
        except (NotAvailableError, BadInputError) as error:
            return error
        self.views = views_of(self.dataset, self.calibration)
        return None

    def _solve(self) -> Calibration:
        instants = range(len(self.dataset.instants_ns))
        return find_calibration(self.dataset, lambda c, k: grow(self.motion.seen_moving(c, k), 5), instants)

    def _points(self) -> dict[str, Points]:
        if self.options.stereo is not None and self.options.stitch is not None:
            return {}
        points = {}
        middle = self.offset.pairs[len(self.offset.pairs) // 2][0]
        for name in self.dataset.cameras:
            there = self.dataset.instants(name)
            if there:
                instant = min(there, key=lambda k: abs(k - middle))
                moving = grow(self.motion.seen_moving(name, instant), 5)
                points[name] = find_points(self.dataset.grey(name, instant), moving)
        return points

    def _pairs(self, cameras: tuple[str, str]) -> list[tuple[int, int]]:
        found = usable_pairs(self.dataset, self.offset, *cameras)
        if not found:
            raise ValueError(f"{cameras[0]} and {cameras[1]} have no images of the same instants")
        return thin(found, self.options.most_instants)

    def _stereo(
        self, points: dict[str, Points], no_views: Exception | None
    ) -> tuple[StereoResult | None, str]:
        if no_views is not None or self.calibration is None:
            return None, str(no_views)
        choice = Choice(self.options.stereo, "asked for")
        if choice.cameras is None:
            choice = choose_stereo(self.views, points)
        if choice.cameras is None:
            return None, choice.why
        for name in choice.cameras:
            if name not in self.views:
                return None, f"camera {name} has no calibration"
        try:
            study = DepthStudy(
                self.dataset,
                self.motion,
                self.views,
                choice.cameras,
                self._pairs(choice.cameras),
                self.calibration.unit,
            )
            instants = study.run(self.stages, self.progress)
        except ValueError as error:
            return None, f"{choice.cameras[0]} and {choice.cameras[1]}: {error}"
        self.pictures += study.pictures(instants, self.folder)
        return study.result(instants, choice.why), ""

    def _stitch(self, points: dict[str, Points]) -> tuple[StitchResult | None, str]:
        choice = Choice(self.options.stitch, "asked for")
        if choice.cameras is None:
            sizes = {name: self.dataset.size(name) for name in points}
            choice = choose_panorama(points, sizes)
        if choice.cameras is None:
            return None, choice.why
        try:
            study = PanoramaStudy(
                self.dataset, self.motion, self.views, choice.cameras, self._pairs(choice.cameras)
            )
            self.progress.step(f"registering {choice.cameras[0]} and {choice.cameras[1]}")
            study.register()
            result = study.result(self.progress, choice.why)
        except ValueError as error:
            return None, str(error)
        self.pictures += study.pictures(self.folder)
        return result, ""
