"""What a comparison found, in one or two sentences for somebody who has never heard of synchronization."""

from reconstruction.results import StereoResult, StitchResult

CLEAR_SHARE = 0.15
"""A loss of this share of the moving pixels is called clear."""
CLEAR_RATIO = 1.5


def verdict(
    stereo: StereoResult | None, stitch: StitchResult | None, offset_ms: float, moving_share: float
) -> str:
    """The sentences; `moving_share` is the share of pixels that move."""
    late = f"{offset_ms:.0f} ms late"
    depth = _depth(stereo, late) if stereo is not None else None
    panorama = _panorama(stitch, late) if stitch is not None else None
    clear = [text for text in (depth, panorama) if text is not None]
    if clear:
        return " ".join(clear)
    if moving_share < 0.0005:
        return (
            "Almost nothing moves in this burst, so synchronization makes no difference that can be seen. "
            "Take a burst of something that moves."
        )
    if stereo is None and stitch is None:
        return "Neither depth nor a panorama could be made from these cameras, so nothing can be compared."
    return (
        f"No clear difference was found between pictures of the same instant and pictures taken {late}. "
        "What moves here is too slow or too small for this delay, or the recordings were not synchronized "
        "to begin with."
    )


def _depth(result: StereoResult, late: str) -> str | None:
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


def _panorama(result: StitchResult, late: str) -> str | None:
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


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.01 or share == 0 else "under 1 %"
