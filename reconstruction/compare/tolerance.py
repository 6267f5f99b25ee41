"""Depth against offset: how late a camera may be.

A dose curve put together from comparisons of offset pictures with those of one instant.

`reconstruct dose`: depth of a pair against offset to both sides, and how much the motion tolerates.
"""

import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import cv2
import msgspec
import numpy as np

from capture_app.errors import BadInputError
from capture_app.terminal import Progress
from reconstruction.calibration.kept import adopt_kept_calibration
from reconstruction.calibration.rig import Rig
from reconstruction.common.memory import memory_budget
from reconstruction.common.native_libraries import library_versions
from reconstruction.common.outputs import comparison_folder, write_metrics
from reconstruction.compare.stereo_study import StereoStudy
from reconstruction.compare.timing_study import TimingStudy
from reconstruction.report.tolerance_report import write_dose_report
from reconstruction.scores.comparison_results import DoseInstant, DosePoint, DoseResult
from reconstruction.scores.study_result import StereoComparison
from reconstruction.scores.tally import MIN_COUNT, MIN_FOR_INTERVAL
from reconstruction.scores.timing import Timing, with_curve_peak, with_depth_scores
from reconstruction.session.conditions import (
    DEFAULT_OFFSET_MS,
    FrameOffset,
    nearest_frame_offset,
    pairs_with_images,
)
from reconstruction.session.dataset import Dataset
from reconstruction.session.instants import choose_moving_instants
from reconstruction.session.picture_checksums import picture_checks

CLEAR_PEAK = 0.15
"""A point of an instant's curve that is higher than the median of the others by this much is its peak."""
LOSS = 0.1
"""The share of the synchronized value whose loss an offset may cause and still be tolerable."""


class DoseCurve:
    """What was found at each offset, to be put together once all are measured."""

    def __init__(self) -> None:
        self._points: list[DosePoint] = []
        self._compared: list[StereoComparison] = []

    def add(self, offset_ms: float, frames: int, scored: StereoComparison) -> None:
        """Add the comparison of pictures so far apart with those of one instant."""
        self._compared.append(scored)
        self._points.append(DosePoint(offset_ms=offset_ms, offset_frames=frames, scores=scored.offset))

    @property
    def points(self) -> tuple[DosePoint, ...]:
        """The points of the curve, from the earliest to the latest."""
        widest = max(self._compared, key=lambda one: one.synced.instants)
        zero = DosePoint(offset_ms=0.0, offset_frames=0, scores=widest.synced)
        return tuple(sorted([*self._points, zero], key=lambda point: point.offset_ms))

    @property
    def measure(self) -> str:
        """Right depth where the truth is known, else any depth."""
        true = self._compared[0].synced.mover_within_2pct is not None
        return "mover_within_2pct" if true else "mover_coverage"

    @property
    def instants(self) -> tuple[DoseInstant, ...]:
        """Every instant's own curve over the points."""
        points = self.points
        pixels: dict[int, int] = {}
        found: dict[int, dict[float, float | None]] = {}
        for point, scored in zip(self._points, self._compared, strict=True):
            for row in scored.per_instant:
                now = int(row["instant"] or 0)
                pixels[now] = int(row["mover_pixels"] or 0)
                values = found.setdefault(now, {})
                values[0.0] = row[f"synced_{self.measure}"]
                values[point.offset_ms] = row[f"offset_{self.measure}"]
        return tuple(
            _instant(now, pixels[now], points, [found[now].get(point.offset_ms) for point in points])
            for now in sorted(found)
        )


def _instant(
    instant: int, pixels: int, points: Sequence[DosePoint], values: list[float | None]
) -> DoseInstant:
    known = {point.offset_ms: v for point, v in zip(points, values, strict=True) if v is not None}
    best = max(known, key=lambda ms: known[ms], default=None)
    peak = None
    if best is not None and len(known) > 1 and pixels >= MIN_COUNT:
        others = float(np.median([value for ms, value in known.items() if ms != best]))
        peak = best if known[best] - others >= CLEAR_PEAK else None
    return DoseInstant(instant=instant, mover_pixels=pixels, values=tuple(values), peak_ms=peak)


def is_decreasing(points: Sequence[DosePoint], measure: str) -> bool:
    """Whether, to either side of zero, no point's interval lies wholly above that of the one before it."""
    known = [
        [one for point in side if (one := point.scores.interval_of(measure)) is not None]
        for side in _sides(points)
    ]
    pairs = [pair for side in known for pair in pairwise(side)]
    return bool(pairs) and all(after.low <= before.high for before, after in pairs)


def tolerable_offset_ms(
    points: Sequence[DosePoint], measure: str, speed_px_per_ms: float | None
) -> float | None:
    """The offset at which a tenth is lost or half of what moves has moved by a pixel; None = neither."""
    limits = []
    for side in _sides(points):
        known = [
            (abs(p.offset_ms), one.value) for p in side if (one := p.scores.interval_of(measure)) is not None
        ]
        least = (1 - LOSS) * known[0][1] if known else 0.0
        for (before, high), (after, low) in pairwise(known):
            if low < least <= high:
                limits.append(before + (after - before) * (high - least) / (high - low))
                break
    if speed_px_per_ms:
        limits.append(1 / speed_px_per_ms)
    return min(limits) if limits else None


def _sides(points: Sequence[DosePoint]) -> tuple[list[DosePoint], list[DosePoint]]:
    """The points from zero to the earliest, and from zero to the latest."""
    early = [point for point in points if point.offset_ms <= 0]
    return early[::-1], [point for point in points if point.offset_ms >= 0]


MAX_STEPS = 4
"""To either side."""


@dataclass(frozen=True, kw_only=True)
class DoseOptions:
    """Options of a dose curve; the pair is names of cameras, None = chosen from the images."""

    max_offset_ms: float = DEFAULT_OFFSET_MS
    stereo: tuple[str, str] | None = None
    max_instants: int = 16
    time_shifts_ms: Mapping[str, float] = field(default_factory=dict)
    """What is added to the times of the cameras it names."""


def dose(session: Path, out: Path | None, options: DoseOptions) -> DoseResult:
    """Measure a pair's depth against offset; write curve, numbers and report to `out` where it is given.

    Raises:
        SimulshotError: the session, the options or the folder cannot be used, or no depth can be made.
    """
    if out is None:
        with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
            return _dose(session, Path(scratch) / "stages", options)
    with comparison_folder(out) as output:
        result = _dose(session, output.folder / "stages", options)
        result = msgspec.structs.replace(result, report="report.html")
        write_dose_report(result, output.folder)
        write_metrics(output.folder, result)
    return result


def _dose(session: Path, stages: Path, options: DoseOptions) -> DoseResult:
    began = time.monotonic()
    dataset = Dataset.open(session, options.time_shifts_ms)
    adopt_kept_calibration(dataset)
    steps = whole_frame_offsets(dataset, options.max_offset_ms)
    rig = Rig(dataset, stages, steps[-1].step)
    rig.check_pair(options.stereo)
    progress = Progress(4)
    progress.step("calibration")
    rig.calibrate()
    progress.step("choosing cameras")
    choice = rig.choose_stereo_pair(options.stereo, steps[-1].pairs[len(steps[-1].pairs) // 2][0])
    if choice.cameras is None:
        raise BadInputError(f"no depth can be made from {session}: {choice.why}")
    progress.step("lateness of what moves")
    timing = TimingStudy(rig).measure_pair(choice.cameras)
    try:
        curve = measure_curve(rig, choice.cameras, steps, options.max_instants, progress, timing)
    except ValueError as error:
        raise BadInputError(f"no depth can be made from {session}: {error}") from error
    progress.last("curve")
    return msgspec.structs.replace(
        curve,
        session=str(session),
        time_shifts_ms=dict(options.time_shifts_ms),
        reason=choice.why,
        calibration=rig.source,
        seconds=time.monotonic() - began,
        memory_notes=memory_budget().notes,
        changed_pictures=picture_checks().changed,
        versions=library_versions(),
    )


def whole_frame_offsets(dataset: Dataset, most_ms: float) -> list[FrameOffset]:
    """The whole-frame offsets up to `most_ms` to either side, from the earliest to the latest; without zero.

    As far as half the burst reaches; at most `MAX_STEPS` to either side.

    Raises:
        BadInputError: there is one instant only.
    """
    if len(dataset.instants_ns) < 2:
        raise BadInputError(
            f"{dataset.name} has one instant only, so nothing in it is offset",
            hint="take a burst of 5 or more",
        )
    spacing_ns = min(b - a for a, b in pairwise(dataset.instants_ns))
    # Half the burst must be left to measure on, and a frame may be a little longer than asked for.
    count = min(int(most_ms * 1e6 / spacing_ns + 0.25), max(1, len(dataset.instants_ns) // 2))
    wanted = sorted({round(k) for k in np.linspace(1, max(1, count), min(max(1, count), MAX_STEPS))})
    late = [
        nearest_frame_offset(dataset.instants_ns, dataset.period_ns, k * spacing_ns / 1e6) for k in wanted
    ]
    return [*(one.reversed for one in reversed(late)), *late]


def measure_curve(
    rig: Rig,
    cameras: tuple[str, str],
    steps: list[FrameOffset],
    max_instants: int,
    progress: Progress,
    timing: Timing,
) -> DoseResult:
    """Measure the curve of a pair at these offsets, every point on the same moving pixels.

    And on the same instants, where the burst has enough that reach all offsets.

    Raises:
        ValueError: the two views overlap too little, or no instant has its frames.
    """
    partners = [dict(pairs_with_images(rig.dataset, step, *cameras)) for step in steps]
    some = sorted(set().union(*partners))
    everywhere = [now for now in some if all(now in one for one in partners)]
    reach = everywhere if len(everywhere) >= MIN_FOR_INTERVAL else some
    if not reach:
        raise ValueError("no instant has its images at any of the offsets")
    nows = choose_moving_instants(rig.motion, cameras, reach, max_instants)
    progress.total += (len(nows) + 1) * len(steps)
    study = StereoStudy(rig, None, cameras, max_instants)
    study.prepare(nows[0], progress)
    curve = DoseCurve()
    for step, later in zip(steps, partners, strict=True):
        pairs = [(now, later[now]) for now in nows if now in later]
        if pairs:
            curve.add(step.actual_ms, step.frames, study.compare_instants(pairs, progress, nows)[0])
    points = curve.points
    peaks = [one.peak_ms for one in curve.instants if one.peak_ms is not None]
    peak_ms = float(np.median(peaks)) if peaks else None
    spacing_ms = min(abs(step.actual_ms) for step in steps)
    judged = with_curve_peak(timing, peak_ms, len(peaks), spacing_ms)
    judged = with_depth_scores(judged, next(point.scores for point in points if point.offset_frames == 0))
    speed = _speed_px_per_ms(rig, cameras[0], nows)
    own = rig.dataset.worst_residual_us()
    tolerable = tolerable_offset_ms(points, curve.measure, speed)
    return DoseResult(
        reference=cameras[0],
        other=cameras[1],
        measure=curve.measure,
        points=points,
        instants=len(nows),
        decreasing=is_decreasing(points, curve.measure),
        timing=judged,
        peak_ms=peak_ms,
        per_instant=curve.instants,
        tolerable_offset_ms=tolerable if judged.synchronized else None,
        speed_px_per_ms=speed,
        sync_residual_us=own,
        sync_residual_px=own / 1000 * speed if own is not None and speed is not None else None,
    )


def _speed_px_per_ms(rig: Rig, camera: str, nows: list[int]) -> float | None:
    """Median speed of the moving pixels in a camera's picture, by optical flow to a neighbour in time."""
    times = rig.dataset.instants_ns
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    lengths = []
    for now in nows[:: max(1, len(nows) // 8)]:
        moving = rig.motion.moving(camera, now)
        near = [k for k in (now + 1, now - 1) if rig.dataset.has_image(camera, k)]
        if not near or not moving.any():
            continue
        found = flow.calc(rig.dataset.grey(camera, now), rig.dataset.grey(camera, near[0]), None)
        apart_ms = abs(times[near[0]] - times[now]) / 1e6
        lengths.append(np.linalg.norm(found[moving], axis=1) / apart_ms)
    return float(np.median(np.concatenate(lengths))) if lengths else None
