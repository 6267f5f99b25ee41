"""Time offsets of all cameras of a rig relative to one of them, from the offsets of camera pairs."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from msgspec import structs

from capture_app.console.terminal import Progress
from capture_app.session.format.common_times import REFERENCE
from reconstruction.common.geometry import angle_deg
from reconstruction.common.joined_names import joined_to
from reconstruction.common.worker_pool import worker_pool
from reconstruction.scene.scene import Scene
from reconstruction.time_offsets.camera_time import CameraTime
from reconstruction.time_offsets.crossings import MIN_JITTER_FRAMES, OffsetFit
from reconstruction.time_offsets.instant_votes import UNCHANGED
from reconstruction.time_offsets.pair_offset import PairOffsets
from reconstruction.time_offsets.single_images import SingleImages, common_glitches

PARTNERS = 3
"""Number of cameras that each camera is measured against: the nearest in viewing direction."""
WIDEST_DEG = 60.0
"""Maximum angle between viewing directions; cameras farther apart see hardly anything in common."""

MOTION = "motion"
"""Source name of an offset measured from motion."""
Pair = tuple[str, str]


def measure_rig_offsets(
    scene: Scene,
    reference: str | None = None,
    progress: Progress | None = None,
    *,
    preferred: str | None = None,
    finder: PairOffsets | None = None,
) -> dict[str, CameraTime]:
    """Measure the offset of every camera of a calibrated rig; the reference's offset is 0.

    `reference` None: the camera that can be measured against the most others; `preferred` breaks a tie.
    The offsets of pairs are adjusted by least squares. Pairs without common motion, or with motion only along
    their epipolar lines, contribute nothing. A camera that no chain of pairs joins to the reference gets a
    reason instead of an offset. `finder` is a `PairOffsets` to reuse that has already read these images.
    """
    finder = finder or PairOffsets(scene)
    pairs = likely_pairs(scene)
    progress = progress or Progress(0, silent=True)
    # The total was announced for all pairs that there may be; a last step follows them.
    progress.done = max(progress.done, progress.total - 1 - len(pairs))

    def measure(pair: Pair) -> OffsetFit:
        progress.step(f"{pair[1]} against {pair[0]}")
        return finder.measure_anywhere(*pair)

    with worker_pool() as pool:
        measured = dict(zip(pairs, pool.map(measure, pairs), strict=True))
    offsets = adjust_offsets(scene.dataset.cameras, reference, measured, preferred)
    return with_changes(offsets, measured, scene.dataset.period_ns / 1e6)


def likely_pairs(scene: Scene) -> list[Pair]:
    """Return pairs of calibrated cameras, each with its `PARTNERS` nearest in viewing direction."""
    views = scene.views
    angles = {
        pair: angle_deg(views[pair[0]].axis, views[pair[1]].axis)
        for pair in combinations((name for name in scene.dataset.cameras if name in views), 2)
    }
    chosen = set()
    for name in views:
        ours = sorted((angle, pair) for pair, angle in angles.items() if name in pair)
        chosen |= {pair for angle, pair in ours[:PARTNERS] if angle < WIDEST_DEG}
    return sorted(chosen)


def adjust_offsets(
    names: Sequence[str],
    reference: str | None,
    measured: Mapping[Pair, OffsetFit],
    preferred: str | None = None,
) -> dict[str, CameraTime]:
    """Adjust the offsets of pairs (first, second), the second's minus the first's, by least squares.

    `reference` and `preferred` are as in `measure_rig_offsets`.
    """
    known = {pair: (fit.offset_ms, fit.sd_ms) for pair, fit in measured.items() if fit.offset_ms is not None}
    reference = reference or max(names, key=lambda name: (len(joined_to(name, known)), name == preferred))
    joined = joined_to(reference, known)
    others = [name for name in names if name in joined and name != reference]
    times = {reference: CameraTime(offset_ms=0.0, sd_ms=0.0, source=REFERENCE)}
    if others:
        rows = [pair for pair in known if pair[0] in joined]
        design = np.array([[(name == b) - (name == a) for name in others] for a, b in rows], float)
        values, sds = (np.array([known[pair][i] for pair in rows]) for i in (0, 1))
        normal = design.T @ (design / sds[:, None] ** 2)
        offsets = np.linalg.solve(normal, design.T @ (values / sds**2))
        left = (values - design @ offsets) / sds
        # Pairs that disagree by more than their errors show that the errors are too small.
        spare = len(rows) - len(others)
        factor = max(1.0, float(np.sqrt((left**2).sum() / spare))) if spare else 1.0
        errors = factor * np.sqrt(np.diagonal(np.linalg.inv(normal)))
        for name, offset, sd in zip(others, offsets, errors, strict=True):
            its = [pair for pair in known if name in pair]
            times[name] = CameraTime(
                offset_ms=float(offset),
                sd_ms=float(sd),
                source=MOTION,
                against=tuple(other for pair in its for other in pair if other != name),
                misfit_px=max((off for pair in its if (off := measured[pair].misfit_px)), default=None),
            )
    return {n: times[n] if n in times else CameraTime(reason=_why(n, measured, known)) for n in names}


def with_changes(
    found: Mapping[str, CameraTime], measured: Mapping[Pair, OffsetFit], period_ms: float
) -> dict[str, CameraTime]:
    """Return the offsets with their changes over the take, and with what single images show.

    A camera's images wander if they do against every other camera.
    """
    known = {pair: fit for pair, fit in measured.items() if fit.offset_ms is not None}
    changes = {name: UNCHANGED for name, offset in found.items() if offset.source == REFERENCE}
    while more := [pair for pair in known if (pair[0] in changes) != (pair[1] in changes)]:
        first, second = more[0]
        if first in changes:
            changes[second] = changes[first].followed_by(known[first, second].change)
        else:
            changes[first] = changes[second].followed_by(known[first, second].change.reversed())
    return {
        name: structs.replace(
            offset, change=changes.get(name) or None, **_single(name, found, known, period_ms)
        )
        for name, offset in found.items()
    }


def _single(
    name: str, found: Mapping[str, CameraTime], known: Mapping[Pair, OffsetFit], period_ms: float
) -> dict[str, Any]:
    """Return a camera's jitter and its `SingleImages`, as fields of `CameraTime`.

    An image is off if it is in all pairs. A lone pair blames the camera that is not the reference.
    """
    its = {pair: fit for pair, fit in known.items() if name in pair and {*pair} <= {*found}}
    moved = tuple({text for fit in its.values() for camera, text in fit.moved.items() if camera == name})
    if not its or (found[name].source == REFERENCE and len(its) == 1):
        return {"images": SingleImages(moved=moved)} if moved else {}
    jitter_ms = min(fit.jitter_ms(period_ms) or 0.0 for fit in its.values())
    odd_ms = [
        {k: ms if pair[1] == name else -ms for k, ms in fit.odd_ms(MIN_JITTER_FRAMES * period_ms).items()}
        for pair, fit in its.items()
    ]
    explained = jitter_ms or any(fit.change for fit in its.values())
    images = SingleImages(
        rows_ms=min((fit.rows_ms if pair[1] == name else -fit.rows_ms for pair, fit in its.items()), key=abs),
        glitches_ms=common_glitches([fit.glitches_ms[pair[1] == name] for pair, fit in its.items()]),
        odd_ms={} if explained else common_glitches(odd_ms),
        unvoted=tuple(sorted(set.intersection(*(set(fit.unvoted) for fit in its.values())))),
        examined=max(fit.examined for fit in its.values()),
        period_ms=period_ms,
        repeats_ms=min(fit.repeats_ms for fit in its.values()),
        moved=moved,
        screens=tuple(sorted({camera for fit in its.values() for camera in fit.screens})),
    )
    return {"jitter_ms": jitter_ms or None, "images": images}


def with_own_changes(cameras: Mapping[str, CameraTime]) -> dict[str, CameraTime]:
    """Return each camera's own changes: one that all others have against the reference is the reference's."""
    others = [
        camera for camera in cameras.values() if camera.source != REFERENCE and camera.offset_ms is not None
    ]
    if len(others) < 2 or (first := others[0].change) is None:
        return dict(cameras)
    own = {
        name: (camera.change or UNCHANGED).followed_by(first.reversed()) or None
        for name, camera in cameras.items()
        if camera.offset_ms is not None
    }
    if sum(change is not None for change in own.values()) > 1:
        return dict(cameras)
    return {name: structs.replace(camera, change=own.get(name)) for name, camera in cameras.items()}


def _why(name: str, measured: Mapping[Pair, OffsetFit], known: Mapping[Pair, object]) -> str:
    """Return why a camera's offset is unknown: the most frequent reason of its pairs."""
    if any(name in pair for pair in measured if pair in known):
        return "it was measured only against cameras whose own offset is not known"
    reasons = [fit.reason for pair, fit in measured.items() if name in pair]
    alone = "it has no calibration, or its view overlaps with no other camera's"
    return max(set(reasons), key=reasons.count) if reasons else alone
