"""Judgement of whether nominally simultaneous images show one instant, measured by motion in them."""

from collections.abc import Mapping, Sequence
from itertools import groupby, pairwise
from statistics import multimode
from typing import Any

import numpy as np
from msgspec import Struct, structs

from capture_app.common.instants import is_same_instant
from reconstruction.common.joined_names import joined_to
from reconstruction.method.study_result import StudyResult
from reconstruction.scene.instant_choice import MIN_INSTANTS
from reconstruction.time_offsets.camera_time import ImageTimes
from reconstruction.time_offsets.crossings import InstantOffset, OffsetFit, fit_slope, scatter_ms
from reconstruction.time_offsets.instant_votes import UNCHANGED, Change
from reconstruction.time_offsets.pair_offset import PairOffsets
from reconstruction.time_offsets.rig_offsets import likely_pairs, measure_rig_offsets
from reconstruction.time_offsets.single_images import SingleImages, stalled_images

SIGMAS = 2.0
"""Standard deviations in the reported error (95 %)."""
ODD_SIGMAS = 3.0
"""Standard deviations from which an offset is claimed."""
MAX_UNSEEN = 0.25
"""Fraction of the instants with motion that may show no offset before and after those that do.

A frame that is dropped there is not seen."""
SURE_FRAMES = 0.1
"""Error, in frames, above which a measurement certifies nothing."""
LOST_FRACTION = 0.5
"""Most of what moves is lost if less of it is found than this fraction of what stands still."""
AGREED_FRACTION = 0.75
"""Fraction of the instants' own depth curves that must peak at the same offset."""
ROW_MISMATCH_PX = 1.0
"""Epipolar error of moving objects from which images may not be of one instant."""
ROW_MISMATCH_RATIO = 5.0
"""Minimum ratio of that error to the error of still objects, which does not depend on timing."""


class Timing(Struct, frozen=True, kw_only=True):
    """Time offset of a camera against another whose images are nominally of the same instants."""

    reference: str
    other: str
    synchronized: bool = False
    """Whether zero is within the offset's error, over the whole take and at its instants."""
    late_ms: float | None = None
    """Median over the instants; None if the images do not determine it.

    If the offset changes, it is that before the first step, or at the middle of a drift.
    """
    uncertainty_ms: float | None = None
    """95 % error of `late_ms`; one frame if `by_depth`."""
    by_depth: bool = False
    """Whether the offset is known only to a frame, by the peak of the depth curve.

    `reason` then says why motion did not determine it.
    """
    offset: bool = False
    """Whether the offset is certainly not zero, or single images certainly have offsets of their own."""
    jitter_ms: float | None = None
    """Standard deviation of the images' own offsets, if it is certainly not zero."""
    change: Change = UNCHANGED
    """How the offset changes over the take: dropped or repeated frames, or another frame rate."""
    disagreeing: tuple[int, ...] = ()
    """Instants that have clear offsets of their own, which nothing explains."""
    misfit_px: float | None = None
    """Median epipolar error of static points (of all if cameras move), if the calibration does not fit."""
    same_frame_ms: float | None = None
    """Upper bound of the offset of images that are of the same frame; None if this is unknown.

    It is determined by motion, or because depth is found best as the images are paired.
    """
    tried_ms: float = 0.0
    """Largest offset that was tried: larger ones are not excluded, if what moves repeats itself."""
    out_of_place_px: float | None = None
    """Epipolar error of moving objects, if images of one instant cannot have it."""
    reason: str = ""
    """Why the offset is unknown, or neither zero nor certainly another value."""
    shift_ms: float | None = None
    """Correction of the other camera's times (`--time-shift-ms`) that pairs the matching images.

    None if they are already paired as well as possible.
    """
    planned_ms: float = 0.0
    """Planned delay of the other camera; not 0 if the cameras were staggered on purpose."""
    instants: tuple[InstantOffset, ...] = ()
    images: SingleImages = SingleImages()
    """Single images of the other camera that are not at this offset, or do not show whether they are."""
    moving_cameras: dict[str, float] = {}
    """Cameras that moved while recording, with their motion in px from frame to frame."""

    @property
    def cameras(self) -> tuple[str, str]:
        """Both cameras: the reference and the other."""
        return self.reference, self.other

    @property
    def option(self) -> str:
        """Command-line option that pairs the matching images; empty if none does."""
        return "" if self.shift_ms is None else f"--time-shift-ms {self.other}={self.shift_ms:.4g}"


def measure_pair_timing(
    offsets: PairOffsets, cameras: tuple[str, str], fit: OffsetFit | None = None, unseen: str = ""
) -> Timing:
    """Measure and judge the second camera's time offset against the first, at instants with motion.

    A `fit` is the offset as measured by other means, and `unseen` why these do not show it throughout.
    """
    dataset, (first, second) = offsets.dataset, cameras
    fit = fit or offsets.measure_anywhere(*cameras)
    spacing_ms = min((b - a for a, b in pairwise(dataset.instants_ns)), default=dataset.period_ns) / 1e6
    times = ImageTimes(dataset, cameras)
    apart = [times.middle_ms(second, k) - times.middle_ms(first, k) for k in dataset.instants(*cameras)]
    moving = {name: px * spacing_ms / ms for name, (px, ms) in offsets.moving(cameras).items()}
    timing = judge_timing(cameras, fit, float(np.median(apart or [0.0])), spacing_ms, moving)
    timing = with_repeats(
        timing, {name: offsets.repeated(name) for name in cameras}, stalled_images(dataset, cameras)
    )
    timing = with_unseen_ends(timing, unseen or unseen_ends(fit))
    timing = without_common_times(timing, dataset.unsynchronized)
    timing = structs.replace(timing, tried_ms=offsets.max_offset_ms)
    return with_planned_delay(timing, dataset.planned_delay_ms(first, second))


def measure_rig_timing(offsets: PairOffsets, pair: tuple[str, str] | None) -> "SessionTiming":
    """Measure every camera's time offset from many pairs, against one of the most that are together.

    Of several such cameras, the reference is the most informative one, or else one of the `pair`.
    """
    scene, period_ms = offsets.scene, offsets.dataset.period_ns / 1e6
    rig_offsets = measure_rig_offsets(scene, preferred=pair[0] if pair else None, finder=offsets)
    measured = {two: offsets.measure_anywhere(*two) for two in likely_pairs(scene)}
    steady = steady_pairs(measured, period_ms)
    first = next(name for name, offset in rig_offsets.items() if offset.sd_ms == 0)
    reference = most_together((first, *(pair or ()), *rig_offsets), steady, period_ms)
    if reference != first:
        rig_offsets = measure_rig_offsets(scene, reference, finder=offsets)
    certain = joined_to(reference, steady)
    judged = []
    for name, offset in rig_offsets.items():
        if name == reference:
            continue
        fit = OffsetFit(
            offset.offset_ms,
            offset.sd_ms,
            offset.reason,
            misfit_px=offset.misfit_px,
            change=offset.change or UNCHANGED,
            repeats_ms=offset.images.repeats_ms,
            rows_ms=offset.images.rows_ms,
            moved=dict(zip([name], offset.images.moved, strict=False)),
            screens=offset.images.screens,
        )
        both = reference, name
        own = [measured[two].offset_ms for two in (both, both[::-1]) if two in measured]
        # The adjusted offsets of a rig are means, and have no instants of their own.
        is_mean = name in certain or bool(fit.change) or own in ([], [None])
        unseen = (
            ""
            if name in certain
            else "no chain of pairs of cameras shows one steady offset from the first motion to the last"
        )
        judged.append(measure_pair_timing(offsets, both, fit if is_mean else None, unseen))
    return SessionTiming(reference=reference, cameras=tuple(judged))


def steady_pairs(
    measured: Mapping[tuple[str, str], OffsetFit], period_ms: float
) -> dict[tuple[str, str], float]:
    """Return the pairs of cameras with one offset in all of the motion, and that offset in ms."""
    limit_ms = SURE_FRAMES * period_ms
    return {
        pair: fit.offset_ms
        for pair, fit in measured.items()
        if fit.offset_ms is not None
        and not (fit.change or fit.rows_ms or fit.disagreeing or any(fit.glitches_ms) or unseen_ends(fit))
        and not (fit.odd_ms(limit_ms) or fit.jitter_ms(period_ms))
        and SIGMAS * _max_jitter_ms(fit.instants, fit.offset_ms) <= limit_ms
    }


def most_together(names: Sequence[str], steady: Mapping[tuple[str, str], float], period_ms: float) -> str:
    """Return the first of the cameras that steady pairs without offset join to the most others."""
    equal = [pair for pair, late_ms in steady.items() if abs(late_ms) <= SURE_FRAMES * period_ms]
    return max(names, key=lambda name: len(joined_to(name, equal)))


def judge_timing(
    cameras: tuple[str, str],
    fit: OffsetFit,
    apart_ms: float,
    spacing_ms: float,
    moving_cameras: dict[str, float] | None = None,
) -> Timing:
    """Judge a measured time offset.

    `apart_ms` is the delay of the second camera's images by their timestamps. `spacing_ms` is the
    frame period. Images are called synchronized only if the error is small and contains zero, no image
    pair is off by more than that, and the calibration fits.
    """
    reference, other = cameras
    fit = fit.later(apart_ms)
    unknown = Timing(
        reference=reference,
        other=other,
        reason=fit.reason,
        misfit_px=fit.misfit_px,
        instants=fit.instants,
        moving_cameras=moving_cameras or {},
        change=fit.change,
        disagreeing=tuple(sorted({*fit.disagreeing, *fit.glitches_ms[1]})),
        images=SingleImages(
            glitches_ms={**fit.glitches_ms[1]},
            unvoted=fit.unvoted,
            examined=fit.examined,
            period_ms=spacing_ms,
            repeats_ms=fit.repeats_ms,
            rows_ms=fit.rows_ms,
            moved=tuple(fit.moved.values()),
            screens=fit.screens,
        ),
    )
    if fit.offset_ms is None or fit.sd_ms is None:
        return unknown
    late, sd, instants = fit.offset_ms, fit.sd_ms, fit.instants
    limit_ms = SURE_FRAMES * spacing_ms
    if fit.change:
        return structs.replace(
            unknown,
            late_ms=late,
            uncertainty_ms=SIGMAS * sd,
            offset=True,
            reason=fit.change.describe(other, reference),
        )
    odd_ms = fit.odd_ms(limit_ms)
    possible_ms = SIGMAS * _max_jitter_ms(instants, late)
    jitter_ms, drifts = fit.jitter_ms(spacing_ms), scatter_ms(instants, spacing_ms)[1]
    if drifts:
        low, high = (end(instant.late_ms for instant in instants) for end in (min, max))
        reason = f"the offset drifts between {low:+.1f} and {high:+.1f} ms, by clocks or a wrong calibration"
        return structs.replace(unknown, reason=f"{reason}: check that with a board")
    offset = abs(late) > ODD_SIGMAS * sd
    end_ms = _largest_by_slope_ms(instants, late)
    points = "matched points" if moving_cameras else "points at rest"
    listed = ", ".join(map(str, unknown.disagreeing))
    doubts = {
        f"{other}'s frames wander by ± {SIGMAS * (jitter_ms or 0.0):.1f} ms": jitter_ms is not None,
        f"the calibration does not fit the pictures: {points} are {fit.misfit_px or 0.0:.1f} pixels off "
        "their epipolar lines; check it with a board": fit.misfit_px is not None,
        # Within an offset's own error, a slope may be that of what was seen first and last.
        f"the offset changes over the take, to {end_ms:+.1f} ms": abs(end_ms) > limit_ms
        and (abs(end_ms - late) > ODD_SIGMAS * sd if offset else SIGMAS * sd <= limit_ms),
        "the error of the measured offset is more than a tenth of a frame": SIGMAS * sd > limit_ms,
        f"{len(odd_ms)} of {len(instants)} instants disagree with the others": bool(odd_ms),
        f"instant {listed} disagrees with the others": len(unknown.disagreeing) == 1,
        f"instants {listed} disagree with the others": len(unknown.disagreeing) > 1,
        f"single images may be off by up to {possible_ms:.1f} ms": possible_ms > limit_ms,
        "the measured offset is neither clearly zero nor clearly different from zero": not offset
        and abs(late) > SIGMAS * sd,
    }
    reason = next((text for text, holds in doubts.items() if holds), "")
    # The frame needs far less evidence: only its neighbours must be excluded.
    same = is_same_instant(abs(late) + ODD_SIGMAS * sd, spacing_ms) and all(
        abs(instant.late_ms) - ODD_SIGMAS * instant.sd_ms < spacing_ms / 2 for instant in instants
    )
    # If measured images disagree, others may be farther off.
    same &= not unknown.disagreeing and (not odd_ms or is_same_instant(possible_ms, spacing_ms))
    far_ms = [possible_ms, *(abs(late + ms) for ms in odd_ms.values())] if odd_ms else []
    denied = offset or jitter_ms is not None or fit.rows_ms != 0
    return structs.replace(
        unknown,
        synchronized=not denied and not reason,
        late_ms=late,
        uncertainty_ms=SIGMAS * sd,
        offset=denied,
        jitter_ms=jitter_ms,
        same_frame_ms=max([abs(late) + SIGMAS * sd, *far_ms]) if same and not denied else None,
        reason=reason,
        shift_ms=round(late - apart_ms, 2) if offset and round(late / spacing_ms) else None,
    )


def _largest_by_slope_ms(instants: Sequence[InstantOffset], late_ms: float) -> float:
    """Return the largest offset of the measured instants if they certainly drift, else 0."""
    if len(instants) < MIN_INSTANTS:
        return 0.0
    slope_ms, sd_ms, middle = fit_slope(instants)
    if abs(slope_ms) < ODD_SIGMAS * sd_ms:
        return 0.0
    ends = (late_ms + slope_ms * (instants[k].instant - middle) for k in (0, -1))
    return max(ends, key=abs)


def _max_jitter_ms(instants: Sequence[InstantOffset], late_ms: float) -> float:
    """Return the upper bound (95 %) of the jitter, a standard deviation, from the scatter about a delay.

    With more jitter, so little scatter would be improbable (Q-profile method, Viechtbauer 2007). A square
    counts 4 at most, so that a wrong match does not raise the bound; the quantile falls by 4 % at most.
    """
    if not instants:
        return 0.0
    variances = np.array([instant.sd_ms for instant in instants]) ** 2
    scatter = np.array([instant.late_ms - late_ms for instant in instants]) ** 2
    # The 5 % quantile of chi-squared (Wilson and Hilferty 1931).
    part = 2 / (9 * len(instants))
    min_count = len(instants) * (1 - part - 1.64 * np.sqrt(part)) ** 3
    jitters = np.linspace(0, 3 * np.sqrt(scatter.max() + variances.max()), 200)
    possible = np.minimum(scatter / (variances + jitters[:, None] ** 2), 4).sum(1) >= min_count
    return float(jitters[possible].max(initial=0.0))


def unseen_ends(fit: OffsetFit) -> str:
    """Return why a drop may hide from two cameras that show their offset in a part of the motion alone.

    A single instant at an end may be a wrong match.
    """
    if fit.moved:
        return f"{' and '.join(fit.moved)} was moved during the take"
    surely = sorted(instant.instant for instant in fit.instants)[1:-1] or [0]
    first, last = surely[0], surely[-1]
    unseen = sum(not first <= k <= last for k in fit.unvoted) > MAX_UNSEEN * fit.examined
    return f"the offset is surely seen at instants {first} to {last} alone; others move too" if unseen else ""


def with_unseen_ends(timing: Timing, reason: str) -> Timing:
    """Return the judgement of cameras whose offset does not show throughout, if a `reason` says so.

    Neither synchronized nor of one frame: what is dropped before or after the part that shows is not seen.
    """
    return _denied(timing, timing.reason or reason) if reason and not timing.offset else timing


def without_common_times(timing: Timing, problem: str) -> Timing:
    """Return the judgement of a recording whose times have this `problem`, if any: never synchronized.

    Agreement by motion near the recorded times does not exclude another offset that fits as well.
    """
    if not problem or (not timing.synchronized and timing.same_frame_ms is None):
        return timing
    reason = f"the recording is {problem.partition(':')[0]}, and reconstruct time --apply has not aligned it"
    return _denied(timing, reason)


def with_repeats(
    timing: Timing, repeated: Mapping[str, tuple[int, ...]], stalled: Mapping[str, tuple[int, ...]]
) -> Timing:
    """Return the judgement of cameras that repeat images, or show a moment twice: never synchronized."""
    images = structs.replace(timing.images, repeated=repeated[timing.other], stalled=stalled[timing.other])
    timing = structs.replace(timing, images=images)
    names = [name for name in repeated if repeated[name] or stalled[name]]
    if not names or timing.offset:
        return timing
    odd = {k for name in names for k in (*repeated[name], *stalled[name])}.union(timing.disagreeing)
    reason = timing.reason or f"{' and '.join(names)} repeats images, or shows a moment twice"
    return structs.replace(_denied(timing, reason), disagreeing=tuple(sorted(odd)))


def with_planned_delay(timing: Timing, planned_ms: float) -> Timing:
    """Return the judgement of cameras that are staggered by `planned_ms`; unless 0, never synchronized."""
    if not planned_ms:
        return timing
    reason = timing.reason or f"{timing.other} is staggered by {planned_ms:.2f} ms on purpose"
    return structs.replace(_denied(timing, reason), planned_ms=planned_ms, shift_ms=None)


def with_depth_runs(timing: Timing, peaks_ms: Mapping[int, float], spacing_ms: float) -> Timing:
    """Return the judgement without one common frame if successive instants find most depth at another offset.

    `peaks_ms` holds the offset of each instant whose own depth curve has a clear maximum, in order. A single
    one may be a wrong match; the first or the last counts if motion tells no frame, as a drop hides there. A
    measured offset, a change of it and a certificate by motion remain.
    """
    instants, offsets_ms = [*peaks_ms], [*peaks_ms.values()]
    mode_ms = min(multimode(offsets_ms), default=0.0)
    runs = [[*run] for _, run in groupby(range(len(offsets_ms)), key=offsets_ms.__getitem__)]
    ends = {0, len(instants) - 1} if timing.same_frame_ms is None else set()
    odd = [
        [instants[k] for k in run]
        for run in runs
        if (len(run) > 1 or ends & {*run}) and abs(offsets_ms[run[0]] - mode_ms) > spacing_ms / 2
    ]
    if timing.offset or timing.synchronized or timing.misfit_px is not None or not odd:
        return timing
    where = [f"{_paired(peaks_ms[run[0]])} at {_instants(run)}" for run in odd]
    reason = f"depth is found best {', '.join(where)}, and {_paired(mode_ms)} at most others"
    disagreeing = {*timing.disagreeing, *(k for run in odd for k in run)}
    return structs.replace(_denied(timing, reason), disagreeing=tuple(sorted(disagreeing)))


def _instants(run: Sequence[int]) -> str:
    return f"instants {run[0]} to {run[-1]}" if len(run) > 1 else f"instant {run[0]}"


def _paired(later_ms: float) -> str:
    return f"with the second picture {later_ms:+.0f} ms later" if later_ms else "as recorded"


def with_curve_peak(timing: Timing, peaks_ms: Mapping[int, float], spacing_ms: float) -> Timing:
    """Return the judgement combined with the offset, in whole frames, at which most depth is found.

    `peaks_ms` holds the offset of each instant whose own curve has a clear maximum, in order. If these agree,
    the offset is known to a frame. That overrides a contrary certificate, and it is the result if motion is
    inconclusive; but it is no common frame if much moves before or after these instants.
    """
    offsets_ms = [*peaks_ms.values()]
    peak_ms = min(multimode(offsets_ms), default=0.0)
    agreed = len(peaks_ms) >= MIN_INSTANTS and offsets_ms.count(peak_ms) >= AGREED_FRACTION * len(peaks_ms)
    if timing.misfit_px is not None or not agreed or timing.disagreeing:
        return timing
    known = timing.late_ms is not None and timing.uncertainty_ms is not None
    max_ms = abs(timing.late_ms or 0.0) + (timing.uncertainty_ms or 0.0) if known else spacing_ms
    if is_same_instant(peak_ms, spacing_ms):
        if timing.same_frame_ms is None and not timing.synchronized and _moves_beside(timing, [*peaks_ms]):
            return timing
        return structs.replace(timing, same_frame_ms=None if timing.offset else min(max_ms, spacing_ms / 2))
    if timing.synchronized or timing.same_frame_ms is not None:
        return _denied(timing, f"depth is found best {_paired(peak_ms)}")
    if timing.offset or max_ms < abs(peak_ms) - spacing_ms / 2:
        return timing
    return structs.replace(
        timing,
        late_ms=-peak_ms,
        uncertainty_ms=spacing_ms,
        by_depth=True,
        offset=True,
        shift_ms=round(-peak_ms, 2),
    )


def _moves_beside(timing: Timing, instants: Sequence[int]) -> bool:
    """Return whether much moves before or after these instants, farther from them than they are apart."""
    apart = max(b - a for a, b in pairwise(instants))
    moving = {*timing.images.unvoted, *(timed.instant for timed in timing.instants)}
    beside = [k for k in moving if not instants[0] - apart < k < instants[-1] + apart]
    return len(beside) > MAX_UNSEEN * len(moving)


def with_depth(timing: Timing, depth: StudyResult[Any]) -> Timing:
    """Return the judgement combined with the depth of the images as recorded.

    The images are of different instants if most of what moves is lost and has an epipolar error, while still
    objects are found without one. If motion contradicts this, nothing is certain.
    """
    # Correct depth, if the true depth is known.
    measure = "coverage" if depth.value("mover_within_2pct") is None else "within_2pct"
    moving, still = (depth.value(f"{part}_{measure}") for part in ("mover", "static"))
    rows, control = depth.value("mover_epipolar_px"), depth.value("static_epipolar_px")
    if moving is None or still is None or rows is None or control is None:
        return timing
    lost = moving < LOST_FRACTION * still and rows > max(ROW_MISMATCH_PX, ROW_MISMATCH_RATIO * control)
    if timing.offset or timing.misfit_px is not None or not lost:
        return timing
    if timing.synchronized:
        reason = f"most moving objects are lost and {rows:.0f} pixels off their rows, unlike static ones"
        return structs.replace(_denied(timing, reason), out_of_place_px=rows)
    if timing.same_frame_ms is not None:
        return timing
    return structs.replace(timing, late_ms=None, uncertainty_ms=None, offset=True, out_of_place_px=rows)


def _denied(timing: Timing, reason: str) -> Timing:
    """Return the judgement without its certificate, with the reason."""
    return structs.replace(timing, synchronized=False, same_frame_ms=None, reason=reason)


class SessionTiming(Struct, frozen=True, kw_only=True):
    """Time offsets of all cameras against a reference; each entry of `cameras` is one camera."""

    reference: str
    cameras: tuple[Timing, ...]

    @property
    def together(self) -> frozenset[str]:
        """Cameras that show the same instant as the reference, including the reference."""
        return frozenset({self.reference, *(camera.other for camera in self.cameras if camera.synchronized)})
