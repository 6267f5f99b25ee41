"""`reconstruct dose`: how much delay of one camera the motion of a burst tolerates."""

import tempfile
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np

from capture_app.errors import BadInputError
from capture_app.terminal import Progress
from reconstruction.calibration.adoption import adopt_kept_calibration
from reconstruction.calibration.rig import Rig
from reconstruction.common.memory_budget import memory_budget
from reconstruction.common.native_libraries import library_versions
from reconstruction.common.output_folder import comparison_folder, write_metrics
from reconstruction.compare.stereo_study import StereoStudy
from reconstruction.panorama.optical_flow import dense_flow
from reconstruction.report.dose_report import write_dose_report
from reconstruction.scores.results import DosePoint, DoseResult
from reconstruction.session.conditions import DEFAULT_OFFSET_MS
from reconstruction.session.dataset import Dataset
from reconstruction.session.frame_offset import (
    FrameOffset,
    evenly_spread,
    nearest_frame_offset,
    pairs_with_images,
)

MAX_STEPS = 8
LOSS = 0.1
"""The share of the synchronized value whose loss an offset may cause and still be tolerable."""


@dataclass(frozen=True, kw_only=True)
class DoseOptions:
    """Options of a dose curve; the pair is names of cameras, None = chosen from the images."""

    max_offset_ms: float = DEFAULT_OFFSET_MS
    stereo: tuple[str, str] | None = None
    max_instants: int = 16


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
    dataset = Dataset.open(session)
    adopt_kept_calibration(dataset)
    steps = whole_frame_offsets(dataset, options.max_offset_ms)
    rig = Rig(dataset, stages, steps[-1].step)
    rig.check_pair(options.stereo)
    progress = Progress(3)
    progress.step("calibration")
    rig.calibrate()
    progress.step("choosing cameras")
    choice = rig.choose_stereo_pair(options.stereo, steps[-1].pairs[len(steps[-1].pairs) // 2][0])
    if choice.cameras is None:
        raise BadInputError(f"no depth can be made from {session}: {choice.why}")
    try:
        curve = measure_curve(rig, choice.cameras, steps, options.max_instants, progress)
    except ValueError as error:
        raise BadInputError(f"{choice.cameras[0]} and {choice.cameras[1]}: {error}") from error
    progress.last("curve")
    return msgspec.structs.replace(
        curve,
        session=str(session),
        reason=choice.why,
        calibration=rig.source,
        seconds=time.monotonic() - began,
        memory_notes=memory_budget().notes,
        versions=library_versions(),
    )


def whole_frame_offsets(dataset: Dataset, most_ms: float) -> list[FrameOffset]:
    """The whole-frame offsets up to `most_ms`, or as far as the burst reaches; at most `MAX_STEPS`.

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
    return [
        nearest_frame_offset(dataset.instants_ns, dataset.period_ns, k * spacing_ns / 1e6) for k in wanted
    ]


def measure_curve(
    rig: Rig, cameras: tuple[str, str], steps: list[FrameOffset], max_instants: int, progress: Progress
) -> DoseResult:
    """Measure the curve of a pair at these offsets, every point on the same instants and moving pixels.

    Raises:
        ValueError: the two views overlap too little, or no instant has all its frames.
    """
    later = [dict(pairs_with_images(rig.dataset, step, *cameras)) for step in steps]
    common = [now for now in later[0] if all(now in partners for partners in later)]
    if not common:
        raise ValueError("no instant has its images at all the offsets")
    nows = evenly_spread(common, max_instants)
    progress.total += len(nows) * len(steps) + len(steps)
    study = StereoStudy(rig, None, cameras, max_instants)
    study.prepare(nows[0], progress)
    points: list[DosePoint] = []
    for step, partners in zip(steps, later, strict=True):
        pairs = [(now, partners[now]) for now in nows]
        scored, _ = study.compare_instants(pairs, progress)
        if not points:
            points.append(DosePoint(offset_ms=0.0, offset_frames=0, scores=scored.synced))
        points.append(DosePoint(offset_ms=step.actual_ms, offset_frames=step.frames, scores=scored.offset))
    true = points[0].scores.mover_within_2pct is not None
    name = "mover_within_2pct" if true else "mover_coverage"
    speed = _speed_px_per_ms(rig, cameras[0], nows)
    own = rig.dataset.worst_residual_us()
    return DoseResult(
        reference=cameras[0],
        other=cameras[1],
        measure=name,
        points=tuple(points),
        instants=len(nows),
        decreasing=is_decreasing(points, name),
        tolerable_offset_ms=tolerable_offset_ms(points, name, speed),
        speed_px_per_ms=speed,
        sync_residual_us=own,
        sync_residual_px=own / 1000 * speed if own is not None and speed is not None else None,
    )


def is_decreasing(points: list[DosePoint], measure: str) -> bool:
    """Whether no point's interval lies wholly above that of the one before it."""
    known = [one for point in points if (one := point.scores.interval_of(measure)) is not None]
    return len(known) > 1 and all(after.low <= before.high for before, after in pairwise(known))


def tolerable_offset_ms(points: list[DosePoint], measure: str, speed_px_per_ms: float | None) -> float | None:
    """The offset at which a tenth is lost or half of what moves has moved by a pixel; None = neither."""
    limits = []
    known = [(p.offset_ms, one.value) for p in points if (one := p.scores.interval_of(measure)) is not None]
    if known:
        least = (1 - LOSS) * known[0][1]
        for (before, high), (after, low) in pairwise(known):
            if low < least <= high:
                limits.append(before + (after - before) * (high - least) / (high - low))
                break
    if speed_px_per_ms:
        limits.append(1 / speed_px_per_ms)
    return min(limits) if limits else None


def _speed_px_per_ms(rig: Rig, camera: str, nows: list[int]) -> float | None:
    """Median speed of the moving pixels in a camera's picture, by optical flow to a neighbour in time."""
    times = rig.dataset.instants_ns
    lengths = []
    for now in nows[:: max(1, len(nows) // 8)]:
        moving = rig.motion.moving(camera, now)
        near = [k for k in (now + 1, now - 1) if rig.dataset.has_image(camera, k)]
        if not near or not moving.any():
            continue
        found = dense_flow(rig.dataset.grey(camera, now), rig.dataset.grey(camera, near[0]))
        apart_ms = abs(times[near[0]] - times[now]) / 1e6
        lengths.append(np.linalg.norm(found[moving], axis=1) / apart_ms)
    return float(np.median(np.concatenate(lengths))) if lengths else None
