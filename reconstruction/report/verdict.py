"""What a comparison found, in one or two sentences for somebody who has never heard of synchronization."""

from reconstruction.scores.depth_results import DepthScores, MultiviewComparison, StereoComparison
from reconstruction.scores.panorama_results import PanoramaComparison
from reconstruction.scores.pose_results import PoseComparison

CLEAR_SHARE = 0.15
"""A loss of this share of the moving pixels is reported as clear."""
CLEAR_RATIO = 1.5
ROW_MISMATCH_PX = 1.0
"""Epipolar error of what moves from which pictures may not be of one instant."""
ROW_MISMATCH_RATIO = 5.0
"""And this many times that of what stands still, which does not depend on timing."""


def verdict(
    stereo: StereoComparison | None,
    stitch: PanoramaComparison | None,
    offset_ms: float,
    moving_share: float,
    poses: PoseComparison | None = None,
    multiview: MultiviewComparison | None = None,
) -> str:
    """One or two sentences; `moving_share` is the share of pixels that move, 0..1."""
    late = f"{offset_ms:.0f} ms late"
    if stereo is not None and not plausibly_synchronized(stereo.synced):
        return _not_synchronized(stereo, late)
    depth = _stereo_sentence(stereo, late) if stereo is not None else _multiview_sentence(multiview)
    panorama = _panorama_sentence(stitch, late) if stitch is not None else None
    places = _pose_sentence(poses) if poses is not None else None
    clear = [text for text in (depth, panorama, places) if text is not None]
    if clear:
        return " ".join(clear)
    if moving_share < 0.0005:
        return (
            "Almost nothing moves in this burst, so synchronization makes no difference that can be seen. "
            "Take a burst of something that moves."
        )
    if stereo is None and stitch is None and multiview is None:
        return "Neither depth nor a panorama could be made from these cameras, so nothing can be compared."
    return (
        f"No clear difference was found between pictures of the same instant and pictures taken {late}. "
        "What moves here is too slow or too small for this delay, or the recordings were not synchronized "
        "to begin with."
    )


def plausibly_synchronized(scores: DepthScores) -> bool:
    """Whether the pictures called synchronized can be of one instant.

    They cannot if most of what moves is lost and has an epipolar error, while what stands still is found and
    has none.
    """
    moving, still = _found_shares(scores)
    rows, control = scores.mover_epipolar_px, scores.static_epipolar_px
    if moving is None or still is None or rows is None or control is None:
        return True
    return not (moving < 0.5 * still and rows > ROW_MISMATCH_PX and rows > ROW_MISMATCH_RATIO * control)


def _not_synchronized(result: StereoComparison, late: str) -> str:
    moving, still = _found_shares(result.synced)
    assert moving is not None
    assert still is not None
    what = "the right distance is" if result.synced.mover_within_2pct is not None else "a distance is"
    return (
        f"These cameras were not synchronized. In the pictures as they were recorded, {what} found for "
        f"{_percent(moving)} of what moves but for {_percent(still)} of what stands still, and what moves is "
        f"out of place by {result.synced.mover_epipolar_px:.0f} pixels up or down: the pictures called the "
        f"same instant are of different ones. Taking one of them {late} changes little."
    )


def _found_shares(scores: DepthScores) -> tuple[float | None, float | None]:
    """The share of moving and of still pixels found, correctly where the truth is known."""
    if scores.mover_within_2pct is not None:
        return scores.mover_within_2pct, scores.static_within_2pct
    return scores.mover_coverage, scores.static_coverage


def _stereo_sentence(result: StereoComparison, late: str) -> str | None:
    true = result.synced.mover_within_2pct is not None
    synced = result.synced.mover_within_2pct if true else result.synced.mover_coverage
    offset = result.offset.mover_within_2pct if true else result.offset.mover_coverage
    if synced is None or offset is None or synced - offset < CLEAR_SHARE:
        return None
    what = "the right distance is found" if true else "a distance is found that both pictures agree on"
    first = (
        f"When both pictures show the same instant, {what} for {_percent(synced)} of what moves; "
        f"with one picture {late}, for {_percent(offset)}."
    )
    still, other = result.synced.static_coverage, result.offset.static_coverage
    if still is None or other is None or abs(still - other) > 0.02:
        return first
    return (
        f"{first} What stands still is found equally well both times, so timing alone makes the difference."
    )


def _multiview_sentence(result: MultiviewComparison | None) -> str | None:
    """Depth from all cameras, reported where no pair gives depth."""
    if result is None:
        return None
    true = result.synced.mover_within_2pct is not None
    synced, _ = _found_shares(result.synced)
    offset, _ = _found_shares(result.offset)
    if synced is None or offset is None or synced - offset < CLEAR_SHARE:
        return None
    what = "the right distance is found" if true else "a distance is found that several cameras agree on"
    return (
        f"When all {len(result.cameras)} cameras show the same instant, {what} for {_percent(synced)} of "
        f"what moves; with each camera off by a different delay, for {_percent(offset)}."
    )


def _panorama_sentence(result: PanoramaComparison, late: str) -> str | None:
    synced, offset = (
        (result.synced.mover_flow_p95_px, result.offset.mover_flow_p95_px)
        if result.synced.mover_flow_p95_px is not None and result.offset.mover_flow_p95_px is not None
        else (result.synced.overlap_flow_p95_px, result.offset.overlap_flow_p95_px)
    )
    if offset < CLEAR_RATIO * synced or offset - synced < 1.0:
        return None
    return (
        f"In the panorama, what moves fits together to within {synced:.1f} pixels at the same instant, "
        f"and is off by up to {offset:.0f} with one picture {late}."
    )


def _pose_sentence(result: PoseComparison) -> str | None:
    """None where delays do not harm the poses, since what stands still places the cameras both times."""
    before, after = result.synced, result.offset
    if not result.degraded or before.rotation_deg is None:
        return None
    if after.rotation_deg is None:
        wrong = "no camera can be placed"
    else:
        wrong = f"these angles are wrong by {after.rotation_deg:.0f} degrees"
        if before.rotation_deg > 0.5 * after.rotation_deg:
            wrong = f"only {_percent(after.correct_pairs)} of the pairs are placed correctly"
    return (
        f"So much moves here that it decides where the cameras seem to stand: pictures of one instant give "
        f"the angles between them to {before.rotation_deg:.1g} degrees; with each camera off by a different "
        f"delay, {wrong}."
    )


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.01 or share == 0 else "under 1 %"
