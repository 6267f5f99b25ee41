"""Whether the pictures called one instant are of one instant: measured on what moves in them."""

from collections.abc import Iterable, Sequence
from typing import Any

import msgspec
from msgspec import Struct

from capture_app.common.instants import is_same_instant
from reconstruction.scores.study_result import StudyResult
from reconstruction.time_offsets.crossings import MIN_INSTANTS, InstantOffset, OffsetFit

SIGMAS = 2.0
"""Standard deviations of the error that is shown (95 %)."""
ODD_SIGMAS = 3.0
"""An offset is claimed where zero is further away than this; an instant by itself disagrees from here on."""
SURE_FRAMES = 0.1
"""An error above this share of a frame certifies nothing."""
ODD_FRAMES, ODD_MS = 0.25, 4.0
"""An instant that is less than this from the others, the lesser of both, does not disagree with them."""
ODD_SHARE = 0.2
"""With more of its instants in disagreement, a take has no one lateness."""
LOST_SHARE = 0.5
"""Where less of what moves is found than this share of what stands still, most of it is lost."""
AGREED_SHARE = 0.75
"""The share of the instants' own depth curves that must be highest at one offset."""
ROW_MISMATCH_PX = 1.0
"""Epipolar error of what moves from which pictures may not be of one instant."""
ROW_MISMATCH_RATIO = 5.0
"""And this many times that of what stands still, which does not depend on timing."""


class Timing(Struct, frozen=True, kw_only=True):
    """How much later a camera's pictures were taken than another's that are called of the same instants."""

    reference: str
    other: str
    synchronized: bool = False
    """Zero is the lateness within its error, over the take and at its instants."""
    late_ms: float | None = None
    """The median over the instants; None where the pictures do not tell."""
    uncertainty_ms: float | None = None
    """95 % error of it; one frame where `by_depth`."""
    by_depth: bool = False
    """It is known to a frame only, by where the depth curve is highest; `reason`: why not by what moves."""
    offset: bool = False
    """It is certainly not zero."""
    same_frame_ms: float | None = None
    """The pictures are of the same frame, late by no more than this, by what moves or as depth is found best
    as they are paired; None where neither tells."""
    out_of_place_px: float | None = None
    """Epipolar error of what moves, where pictures of one instant cannot have it."""
    reason: str = ""
    """Why it is not known, or neither zero nor certainly another."""
    shift_ms: float | None = None
    """What added to the other camera's times (`--time-shift-ms`) pairs the pictures that belong together;
    None where they are paired as well as they can be."""
    instants: tuple[InstantOffset, ...] = ()
    moving_cameras: dict[str, float] = {}
    """Cameras that moved while they recorded, and by how many px from frame to frame."""

    @property
    def cameras(self) -> tuple[str, str]:
        """Both."""
        return self.reference, self.other

    @property
    def option(self) -> str:
        """The option that pairs the pictures that belong together; empty where none does."""
        return "" if self.shift_ms is None else f"--time-shift-ms {self.other}={self.shift_ms:.4g}"


def judge_timing(
    cameras: tuple[str, str],
    fit: OffsetFit,
    apart_ms: float,
    spacing_ms: float,
    moving_cameras: dict[str, float] | None = None,
) -> Timing:
    """Judge a measured offset of times: `apart_ms` is how much later the second's times already say it is.

    `spacing_ms` is that of the frames. Synchronized is said only where the error is small, zero lies in it,
    and the instants by themselves agree.
    """
    reference, other = cameras
    moving, fit = moving_cameras or {}, fit.later(apart_ms)
    if fit.offset_ms is None or fit.sd_ms is None:
        return Timing(
            reference=reference, other=other, reason=fit.reason, instants=fit.instants, moving_cameras=moving
        )
    late, sd, instants = fit.offset_ms, fit.sd_ms, fit.instants
    odd = [
        one.instant
        for one in instants
        if abs(one.late_ms - late) > max(ODD_SIGMAS * one.sd_ms, min(ODD_FRAMES * spacing_ms, ODD_MS))
    ]
    agree = len(odd) <= ODD_SHARE * len(instants)
    offset = abs(late) > ODD_SIGMAS * sd
    reason = ""
    if SIGMAS * sd > SURE_FRAMES * spacing_ms:
        reason = "the error of what was measured is more than a tenth of a frame"
    elif not agree:
        reason = f"{len(odd)} of {len(instants)} instants disagree with the others"
    elif not offset and abs(late) > SIGMAS * sd:
        reason = "what was measured is neither clearly zero nor clearly another offset"
    frames = round(late / spacing_ms)
    # Far less has to be known for the frame: that its neighbours are not it.
    same = not offset and agree and is_same_instant(abs(late) + ODD_SIGMAS * sd, spacing_ms)
    return Timing(
        reference=reference,
        other=other,
        synchronized=not offset and not reason,
        late_ms=late,
        uncertainty_ms=SIGMAS * sd,
        offset=offset,
        same_frame_ms=abs(late) + SIGMAS * sd if same else None,
        reason=reason,
        shift_ms=round(late - apart_ms, 2) if offset and frames else None,
        instants=instants,
        moving_cameras=moving,
    )


def without_common_times(timing: Timing, doubt: str) -> Timing:
    """The judgement of a recording whose times are in `doubt`: its pictures are not called synchronized.

    That they agree by what moves near their own times does not say that no other offset fits as well.
    """
    if not timing.synchronized and timing.same_frame_ms is None:
        return timing
    reason = f"the recording is {doubt.partition(':')[0]}, and reconstruct time --apply has not aligned it"
    return msgspec.structs.replace(timing, synchronized=False, same_frame_ms=None, reason=reason)


def with_curve_peak(timing: Timing, peaks_ms: Sequence[float], spacing_ms: float) -> Timing:
    """The judgement with what depth says: at which of the offsets, whole frames, most of it is found.

    `peaks_ms`: of each instant's own curve that has a clear one. Where they agree they tell to a frame: no
    certificate holds against that, and where moving points do not tell, it is what is told.
    """
    peak_ms = max(sorted(set(peaks_ms)), key=peaks_ms.count, default=0.0)
    if len(peaks_ms) < MIN_INSTANTS or peaks_ms.count(peak_ms) < AGREED_SHARE * len(peaks_ms):
        return timing
    known = timing.late_ms is not None and timing.uncertainty_ms is not None
    most_ms = abs(timing.late_ms or 0.0) + (timing.uncertainty_ms or 0.0) if known else spacing_ms
    if is_same_instant(peak_ms, spacing_ms):
        same_ms = None if timing.offset else min(most_ms, spacing_ms / 2)
        return msgspec.structs.replace(timing, same_frame_ms=same_ms)
    if timing.synchronized or timing.same_frame_ms is not None:
        reason = f"depth is found best with the second picture {peak_ms:+.0f} ms later"
        return msgspec.structs.replace(timing, synchronized=False, same_frame_ms=None, reason=reason)
    if timing.offset or most_ms < abs(peak_ms) - spacing_ms / 2:
        return timing
    return msgspec.structs.replace(
        timing,
        late_ms=-peak_ms,
        uncertainty_ms=spacing_ms,
        by_depth=True,
        offset=True,
        shift_ms=round(-peak_ms, 2),
    )


def with_depth(timing: Timing, depth: StudyResult[Any]) -> Timing:
    """The judgement with what depth says of the pictures as they were recorded.

    They are of different instants where most of what moves is lost and has an epipolar error, while what
    stands still is found and has none. Where moving points say otherwise nothing is certain.
    """
    moving, still = found_shares(depth)
    rows, control = depth.value("mover_epipolar_px"), depth.value("static_epipolar_px")
    if timing.offset or moving is None or still is None or rows is None or control is None:
        return timing
    if moving >= LOST_SHARE * still or rows <= max(ROW_MISMATCH_PX, ROW_MISMATCH_RATIO * control):
        return timing
    if timing.synchronized:
        reason = (
            f"most of what moves is lost and lies {rows:.0f} pixels off its rows, unlike what stands still"
        )
        return msgspec.structs.replace(
            timing, synchronized=False, same_frame_ms=None, out_of_place_px=rows, reason=reason
        )
    if timing.same_frame_ms is not None:
        return timing
    return msgspec.structs.replace(
        timing, late_ms=None, uncertainty_ms=None, offset=True, out_of_place_px=rows
    )


def found_shares(depth: StudyResult[Any]) -> tuple[float | None, float | None]:
    """The share of moving and of still pixels found as recorded, correctly where the truth is known."""
    measure = "coverage" if depth.value("mover_within_2pct") is None else "within_2pct"
    return depth.value(f"mover_{measure}"), depth.value(f"static_{measure}")


class RigTiming(Struct, frozen=True, kw_only=True):
    """How much later the cameras' pictures were taken than those of one of them; `cameras`: of each other."""

    reference: str
    cameras: tuple[Timing, ...]

    @property
    def together(self) -> frozenset[str]:
        """The cameras whose pictures are of one instant with the reference's, itself among them."""
        return frozenset({self.reference, *(one.other for one in self.cameras if one.synchronized)})


def are_together(cameras: Iterable[str], pair: Timing | None, rig: RigTiming | None) -> bool:
    """Whether the pictures of all these cameras were found to be of one instant.

    The judgement of a pair by itself counts for these two, and against any group they are in.
    """
    asked = frozenset(cameras)
    if pair is not None:
        measured = frozenset(pair.cameras)
        if asked <= measured or (measured <= asked and not pair.synchronized):
            return pair.synchronized
    return rig is not None and asked <= rig.together


def are_apart(cameras: Iterable[str], pair: Timing | None, rig: RigTiming | None) -> bool:
    """Whether any of these cameras' pictures were found not to be of one instant with another's."""
    asked = frozenset(cameras)
    measured = (pair, *(rig.cameras if rig is not None else ()))
    return any(one is not None and one.offset and asked.issuperset(one.cameras) for one in measured)
