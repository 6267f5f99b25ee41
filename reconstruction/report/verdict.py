"""What a comparison found, in a few sentences for somebody who has never heard of synchronization."""

from reconstruction.report.timing_words import motion_sentence, rig_sentence, timing_sentences
from reconstruction.scores.results import (
    DepthScores,
    MultiviewComparison,
    PanoramaComparison,
    PanoramaScores,
    PoseComparison,
    StereoComparison,
)
from reconstruction.scores.timing import RigTiming, Timing, are_together

DEPTH_MEASURES = ("mover_within_2pct", "mover_coverage")
"""What depth is judged by: correct distances where the truth is known, else any distance."""
PANORAMA_MEASURES = ("mover_misfit_px", "mover_found")
"""What a panorama is judged by: how far off what moves is, else how much of it is found again at all."""
CLEAR_SHARE = 0.15
"""A loss of this share of the moving pixels is reported as clear."""
CLEAR_RATIO = 1.5


def verdict(
    stereo: StereoComparison | None,
    stitch: PanoramaComparison | None,
    offset_ms: float,
    moving_share: float,
    poses: PoseComparison | None = None,
    multiview: MultiviewComparison | None = None,
    timing: Timing | None = None,
    rig: RigTiming | None = None,
    unsynchronized: str = "",
) -> str:
    """A few sentences; `moving_share` is the share of pixels that move, 0..1.

    Pictures are said to be of one instant only where `timing` (of the pair) and `rig` found them so.
    `unsynchronized`: what is known of the times of a recording without common ones.
    """
    unknown = f"This recording is {unsynchronized}." if unsynchronized else ""
    moved = motion_sentence(timing) if timing is not None else ""
    found = _what_was_found(stereo, stitch, offset_ms, moving_share, poses, multiview, timing, rig)
    others = rig_sentence(rig, timing) if rig is not None else ""
    return " ".join(text for text in (unknown, moved, found, others) if text)


def _what_was_found(
    stereo: StereoComparison | None,
    stitch: PanoramaComparison | None,
    offset_ms: float,
    moving_share: float,
    poses: PoseComparison | None,
    multiview: MultiviewComparison | None,
    timing: Timing | None,
    rig: RigTiming | None,
) -> str:
    late = f"{offset_ms:.0f} ms late"

    def together(*cameras: str) -> bool:
        return are_together(cameras, timing, rig)

    if stereo is not None and timing is not None and timing.offset:
        return f"{timing_sentences(timing)} {_as_recorded(stereo)}".strip()
    depth = None
    if stereo is not None:
        moved = timing is not None and bool(timing.moving_cameras)
        depth = _stereo_sentence(stereo, late, together(*stereo.cameras), moved)
    elif multiview is not None:
        depth = _multiview_sentence(multiview, together(*multiview.cameras))
    panorama = _panorama_sentence(stitch, late, together(*stitch.cameras)) if stitch is not None else None
    places = _pose_sentence(poses, together(*poses.cameras)) if poses is not None else None
    clear = [text for text in (depth, panorama, places) if text is not None]
    if clear:
        return " ".join([*clear, *([timing_sentences(timing)] if timing is not None else [])])
    if moving_share < 0.0005:
        return (
            "Almost nothing moves in this burst, so synchronization makes no difference that can be seen. "
            "Take a burst of something that moves."
        )
    if stereo is None and stitch is None and multiview is None:
        return "Neither depth nor a panorama could be made from these cameras, so nothing can be compared."
    if timing is not None and timing.synchronized:
        return (
            f"No clear difference was found between pictures of the same instant and pictures taken {late}: "
            f"what moves here is too slow or too small for this delay. {timing_sentences(timing)}"
        )
    return (
        f"No clear difference was found between the pictures as recorded and pictures taken {late}. "
        "What moves here is too slow or too small for this delay, or the recordings were not synchronized "
        "to begin with."
    ) + (f" {timing_sentences(timing)}" if timing is not None else "")


def _as_recorded(result: StereoComparison) -> str:
    """What is found of what moves and of what stands still in the pictures as they were recorded."""
    moving, still = result.synced.found_shares
    if moving is None or still is None:
        return ""
    what = "the right distance is" if result.synced.mover_within_2pct is not None else "a distance is"
    return (
        f"In the pictures as they were recorded, {what} found for {_percent(moving)} of what moves and for "
        f"{_percent(still)} of what stands still."
    )


def first_known(
    synced: DepthScores | PanoramaScores, offset: DepthScores | PanoramaScores, *measures: str
) -> tuple[str, float, float] | None:
    """The first of these measures that both scores have, and its values; None if there is none."""
    for measure in measures:
        before, after = getattr(synced, measure), getattr(offset, measure)
        if before is not None and after is not None:
            return measure, before, after
    return None


FALLEN_CONTROL = 0.1
"""A loss of this share of what stands still has another reason than timing."""


def _stereo_sentence(result: StereoComparison, late: str, together: bool, moved: bool) -> str | None:
    """As `_depth_sentence`, with what stands still: a control, unless the cameras `moved`."""
    recorded = "both pictures show the same instant" if together else "the pictures are paired as recorded"
    first = _depth_sentence(result, recorded, f"one picture {late}", "both pictures agree on")
    still, other = result.synced.static_coverage, result.offset.static_coverage
    if first is None or still is None or other is None:
        return first
    if still - other > FALLEN_CONTROL:
        return (
            f"{first} What stands still is found less often too ({_percent(still)} and {_percent(other)}): "
            f"timing is not all that differs.{'' if moved else ' Did the cameras move, or the light change?'}"
        )
    if moved or abs(still - other) > 0.02:
        return first
    return (
        f"{first} What stands still is found equally well both times, so timing alone makes the difference."
    )


def _multiview_sentence(result: MultiviewComparison, together: bool) -> str | None:
    cameras = f"all {len(result.cameras)} cameras"
    when = (
        f"{cameras} show the same instant"
        if together
        else f"the pictures of {cameras} are paired as recorded"
    )
    return _depth_sentence(result, when, "each camera off by a different delay", "several cameras agree on")


def _depth_sentence(
    result: StereoComparison | MultiviewComparison, when: str, late: str, agreed: str
) -> str | None:
    """How much of what moves is found in both conditions; None where that is not clearly less when late."""
    known = first_known(result.synced, result.offset, *DEPTH_MEASURES)
    if known is None or known[1] - known[2] < CLEAR_SHARE:
        return None
    measure, synced, offset = known
    correct = measure == DEPTH_MEASURES[0]
    what = "the right distance is found" if correct else f"a distance is found that {agreed}"
    return f"When {when}, {what} for {_percent(synced)} of what moves; with {late}, for {_percent(offset)}."


def _panorama_sentence(result: PanoramaComparison, late: str, together: bool) -> str | None:
    when = "at the same instant" if together else "as recorded"
    misfit = first_known(result.synced, result.offset, PANORAMA_MEASURES[0])
    if misfit is not None and misfit[2] >= max(CLEAR_RATIO * misfit[1], misfit[1] + 1.0):
        return (
            f"In the panorama, what moves fits together to within {misfit[1]:.1f} pixels {when}, "
            f"and is off by {misfit[2]:.0f} with one picture {late}."
        )
    found = first_known(result.synced, result.offset, PANORAMA_MEASURES[1])
    if found is None or found[1] - found[2] < CLEAR_SHARE:
        return None
    return (
        f"Where the pictures of the panorama overlap, {_percent(found[1])} of what moves is in both {when}, "
        f"and {_percent(found[2])} with one picture {late}."
    )


def _pose_sentence(result: PoseComparison, together: bool) -> str | None:
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
    pictures = "pictures of one instant" if together else "the pictures as recorded"
    return (
        f"So much moves here that it decides where the cameras seem to stand: {pictures} give "
        f"the angles between them to {before.rotation_deg:.1g} degrees; with each camera off by a different "
        f"delay, {wrong}."
    )


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.01 or share == 0 else "under 1 %"
