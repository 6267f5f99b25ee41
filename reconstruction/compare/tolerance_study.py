"""`reconstruct tolerance`: a pair's depth against offset in both directions, and the tolerated delay."""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType

import cv2
import numpy as np
from msgspec import structs

from capture_app.common import system
from capture_app.common.errors import BadInputError, NotAvailableError
from capture_app.common.instants import COMPARED_MS
from capture_app.console.terminal import Progress
from reconstruction.common.outputs import REPORT, comparison_folder, write_metrics
from reconstruction.method.comparison_results import InstantTolerance, OffsetTolerance
from reconstruction.method.score import Context, Score, study_reports
from reconstruction.method.spoken import spoken
from reconstruction.method.study_result import Interval, StudyResult
from reconstruction.method.tally import MIN_COUNT, MIN_FOR_INTERVAL
from reconstruction.method.timing import (
    Timing,
    measure_pair_timing,
    with_curve_peak,
    with_depth,
    with_depth_runs,
)
from reconstruction.report.tolerance_report import tolerance_sentence, write_tolerance_report
from reconstruction.scene.conditions import (
    SYNCHRONIZED,
    FrameOffset,
    nearest_frame_offset,
    pairs_with_images,
)
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.instant_choice import choose_moving_instants
from reconstruction.scene.moving_pixels import SceneMotion
from reconstruction.scene.provenance import with_provenance
from reconstruction.scene.scene import Scene
from reconstruction.time_offsets.pair_offset import PairOffsets

Point = StudyResult[dict[str, int]]
MAX_STEPS = 4
"""Maximum number of offsets in either direction."""
CLEAR_PEAK = 0.15
"""Height above the median of the other points from which an instant's highest point is its peak."""
LOSS = 0.1
"""Fraction of the synchronized value that a tolerable offset may lose."""


def curve_measure(points: Sequence[Point]) -> str:
    """Return the name of the curve's measure: correct depth if the true depth is known, else any depth."""
    true = any(point.value("mover_within_2pct") is not None for point in points)
    return "mover_within_2pct" if true else "mover_coverage"


def with_zero(compared: Sequence[Point]) -> tuple[Point, ...]:
    """Return the curve's points from the earliest to the latest, with a point at zero.

    The point at zero is the synchronized value of the point with the most instants.
    """
    widest = max(compared, key=lambda one: one.instants)
    zero = structs.replace(
        widest,
        offsets_ms=dict.fromkeys(widest.cameras, 0.0),
        measures=tuple(
            structs.replace(measure, offset=measure.synced, difference=None)
            for measure in widest.measures
            if measure.synced
        ),
        per_instant=(),
        facts={"offset_frames": 0},
    )
    return tuple(sorted([*compared, zero], key=lambda point: point.late_ms or 0.0))


def instant_curves(points: Sequence[Point], measure: str) -> tuple[InstantTolerance, ...]:
    """Return every instant's own curve over the points."""
    pixels: dict[int, int] = {}
    curves: dict[int, dict[float, float | None]] = {}
    for point in points:
        for row in point.per_instant:
            now = int(row["instant"] or 0)
            pixels[now] = int(row["mover_pixels"] or 0)
            curve = curves.setdefault(now, dict.fromkeys(one.late_ms or 0.0 for one in points))
            curve |= {0.0: row.get(f"synced_{measure}"), point.late_ms or 0.0: row.get(f"offset_{measure}")}
    return tuple(_instant(now, pixels[now], curve) for now, curve in sorted(curves.items()))


def _instant(instant: int, pixels: int, curve: Mapping[float, float | None]) -> InstantTolerance:
    known = {ms: value for ms, value in curve.items() if value is not None}
    best, *others = sorted(known, key=lambda ms: -known[ms]) or [0.0]
    clear = bool(others) and known[best] - np.median([known[ms] for ms in others]) >= CLEAR_PEAK
    return InstantTolerance(
        instant=instant,
        mover_pixels=pixels,
        values=tuple(curve.values()),
        peak_ms=best if clear and pixels >= MIN_COUNT else None,
    )


def is_decreasing(points: Sequence[Point], measure: str) -> bool:
    """Return whether, away from zero, no point's interval is entirely above the one before it."""
    pairs = [pair for curve in _both_directions(points, measure) for pair in pairwise(curve)]
    return bool(pairs) and all(after.ends[0] <= before.ends[1] for (_, before), (_, after) in pairs)


def tolerable_offset_ms(points: Sequence[Point], measure: str, speed_px_per_ms: float | None) -> float | None:
    """Return the tolerable offset, ms; None if the curve does not reach it.

    There a tenth of the measure is lost, or half of the moving pixels have moved by one pixel, whichever
    comes first.
    """
    limits = [1 / speed_px_per_ms] if speed_px_per_ms else []
    for curve in _both_directions(points, measure):
        threshold = (1 - LOSS) * curve[0][1].value if curve else 0.0
        for (before, high), (after, low) in pairwise(curve):
            if low.value < threshold <= high.value:
                fraction = (high.value - threshold) / (high.value - low.value)
                limits.append(before + (after - before) * fraction)
                break
    return min(limits, default=None)


def _both_directions(points: Sequence[Point], measure: str) -> list[list[tuple[float, Interval]]]:
    """Return the known values from zero to the earliest and to the latest point, by absolute offset."""
    known = [(p.late_ms or 0.0, one) for p in points if (one := p.interval(measure, "offset")) is not None]
    return [
        [(-ms, value) for ms, value in reversed(known) if ms <= 0],
        [(ms, value) for ms, value in known if ms >= 0],
    ]


def measure_tolerance(
    session: Path,
    out: Path | None = None,
    *,
    max_offset_ms: float = COMPARED_MS,
    pair: tuple[str, str] | None = None,
    max_instants: int = 16,
    time_shifts_ms: Mapping[str, float] = MappingProxyType({}),
) -> OffsetTolerance:
    """Measure a pair's depth against offset; write curve, numbers and report to `out` if given.

    The two cameras are chosen from the images if no `pair` is given. `time_shifts_ms` is added to the times
    of the named cameras.

    Raises:
        SimulshotError: the session, the options or the folder cannot be used, or no depth can be computed.
    """
    began = system.monotonic_s()
    scene = Scene.open(session, time_shifts_ms)
    scene.given  # noqa: B018  (refuses one that does not fit the images)
    steps = whole_frame_offsets(scene.dataset, max_offset_ms)
    with nullcontext() if out is None else comparison_folder(out) as output:
        pair = scene.named_pair(pair)
        progress = Progress(4 + (max_instants + 1) * len(steps))
        progress.step("calibration")
        scene.calibration  # noqa: B018  (may take long, and may fail)
        progress.step("choosing cameras")
        middle, _ = steps[-1].pairs[len(steps[-1].pairs) // 2]
        context = Context(
            scene=scene,
            step=steps[-1].step,
            middle=middle,
            max_instants=max_instants,
            progress=progress,
        )
        study = _depth_study()(context)
        study.asked = pair
        try:
            study.prepare()
            progress.step("time offset of moving objects")
            timing = measure_pair_timing(PairOffsets(context.compared), study.pair)
            curve = measure_curve(type(study), context, study.pair, steps, timing)
        except ValueError as error:
            raise BadInputError(
                f"no depth can be made from {session}: {error}",
                hint="name two overlapping cameras with --pair, or calibrate the rig again",
            ) from error
        progress.last("curve")
        result = structs.replace(
            curve,
            verdict=tolerance_sentence(spoken(curve, scene.dataset.other_labels)),
            session=str(session),
            labels=scene.dataset.other_labels,
            reason=study.reason,
            report="" if out is None else REPORT,
        )
        result = with_provenance(result, began, time_shifts_ms)
        if output is not None:
            write_tolerance_report(result, output.folder)
            write_metrics(output.folder, result)
    return result


def whole_frame_offsets(dataset: Dataset, max_ms: float) -> list[FrameOffset]:
    """Return the whole-frame offsets up to `max_ms` in both directions, earliest first, without zero.

    They span at most half the burst, with at most `MAX_STEPS` in either direction.

    Raises:
        BadInputError: there is only one instant.
    """
    if len(dataset.instants_ns) < 2:
        raise BadInputError(
            f"{dataset.name} has one instant only, so nothing in it is offset",
            hint="take a burst of 5 or more",
        )
    spacing_ns = min(b - a for a, b in pairwise(dataset.instants_ns))
    # Half the burst must remain to measure on, and a frame may be slightly longer than requested.
    count = max(1, min(int(max_ms * 1e6 / spacing_ns + 0.25), len(dataset.instants_ns) // 2))
    steps = sorted({round(k) for k in np.linspace(1, count, min(count, MAX_STEPS))})
    late = [nearest_frame_offset(dataset.instants_ns, dataset.period_ns, k * spacing_ns / 1e6) for k in steps]
    return [*(point.reversed for point in reversed(late)), *late]


def _depth_study() -> type[Score]:
    """Return the installed study whose depth the tolerance curve uses."""
    studies = (score for score in study_reports().values() if score.of_pair and score.measures_delay)
    if study := next(studies, None):
        return study
    raise NotAvailableError("no study of a pair's depth is installed", hint="install simulshot again")


def measure_curve(
    kind: type[Score],
    context: Context,
    cameras: tuple[str, str],
    steps: list[FrameOffset],
    timing: Timing,
) -> OffsetTolerance:
    """Measure a pair's curve with a study at these offsets; every point uses the same moving pixels.

    All points use the same instants, if enough instants of the burst have frames at all offsets.

    Raises:
        ValueError: the two views overlap too little, or no instant has its frames.
    """
    scene = context.scene
    partners = [dict(pairs_with_images(scene.dataset, step.pairs, *cameras)) for step in steps]
    everywhere = sorted(set(partners[0]).intersection(*partners))
    usable = everywhere if len(everywhere) >= MIN_FOR_INTERVAL else sorted(set().union(*partners))
    if not usable:
        raise ValueError("no instant has its images at any of the offsets")
    nows = choose_moving_instants(context.compared.motion, cameras, usable, context.max_instants)
    study = kind(replace(context, offset=None, middle=nows[0]))
    study.asked = cameras
    study.prepare()
    pairs = [[(now, later[now]) for now in nows if now in later] for later in partners]
    compared = [
        structs.replace(
            study.compare_instants(ours, SYNCHRONIZED, {cameras[0]: 0.0, cameras[1]: step.actual_ms}),
            facts={"offset_frames": step.frames},
        )
        for step, ours in zip(steps, pairs, strict=True)
        if ours
    ]
    points, measure = with_zero(compared), curve_measure(compared)
    instants = instant_curves(points, measure)
    of_instants = {moment.instant: moment.peak_ms for moment in instants if moment.peak_ms is not None}
    spacing_ms = min(abs(step.actual_ms) for step in steps)
    judged = (
        # The depth of a few frames to either side says nothing of a recording that was never aligned.
        timing
        if scene.dataset.unsynchronized
        else with_curve_peak(with_depth_runs(timing, of_instants, spacing_ms), of_instants, spacing_ms)
    )
    if timing.late_ms is None:
        judged = structs.replace(judged, tried_ms=max(abs(step.actual_ms) for step in steps))
    judged = with_depth(judged, next(point for point in points if not point.late_ms))
    speed = _speed_px_per_ms(context.compared.motion, cameras[0], nows)
    own = scene.dataset.worst_residual_us()
    is_known = judged.synchronized and not scene.lenses.doubt()
    return OffsetTolerance(
        cameras=cameras,
        calibration=scene.source,
        lenses=scene.lenses,
        measure=measure,
        points=points,
        instants=len(nows),
        decreasing=is_decreasing(points, measure),
        timing=judged,
        peak_ms=float(np.median([*of_instants.values()])) if of_instants else None,
        per_instant=instants,
        tolerable_offset_ms=tolerable_offset_ms(points, measure, speed) if is_known else None,
        speed_px_per_ms=speed,
        sync_residual_us=own,
        sync_residual_px=own / 1000 * speed if own is not None and speed is not None else None,
    )


def _speed_px_per_ms(motion: SceneMotion, camera: str, nows: list[int]) -> float | None:
    """Return the median speed of a camera's moving pixels, by optical flow to a neighbouring frame."""
    dataset = motion.dataset
    times, grey = dataset.instants_ns, dataset.grey
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    lengths = [np.zeros(0, np.float32)]
    for now in nows[:: max(1, len(nows) // 8)]:
        moving = motion.moving(camera, now)
        near = next((k for k in (now + 1, now - 1) if dataset.has_image(camera, k)), None)
        if near is not None and moving.any():
            flows = flow.calc(grey(camera, now), grey(camera, near), None)[moving]
            lengths.append(np.linalg.norm(flows, axis=1) / (abs(times[near] - times[now]) / 1e6))
    every = np.concatenate(lengths)
    return float(np.median(every)) if len(every) else None
