"""What a comparison found, in sentences.

What was measured of a pair's timing, in words.

What a comparison found, in a few sentences for somebody who has never heard of synchronization.
"""

from capture_app.text import count
from reconstruction.scores.study_result import (
    DepthScores,
    MultiviewComparison,
    PanoramaComparison,
    PanoramaScores,
    PoseComparison,
    StereoComparison,
)
from reconstruction.scores.timing import RigTiming, Timing, are_together

MOST_NAMED = 4
"""Cameras that are named in a sentence."""


def timing_sentences(timing: Timing) -> str:
    """How late the second camera is and what to do about it, or why that is not known."""
    by = f"by what moves at {count(len(timing.instants), 'instant')}"
    if timing.synchronized:
        return (
            f"{timing.other} is {_lateness(timing)} against {timing.reference} ({by}; 95 %): the same "
            "instant, as far as these pictures can tell."
        )
    if timing.offset:
        return f"{_offset(timing, by)}{_odd(timing)} {_what_to_do(timing)}".rstrip()
    told = f"Whether these cameras were synchronized cannot be told from these pictures: {timing.reason}."
    if timing.late_ms is None:
        return told
    return f"{told} {timing.other} is {_lateness(timing)} against {timing.reference} ({by}; 95 %)."


def rig_sentence(rig: RigTiming, pair: Timing | None) -> str:
    """Which cameras are certainly late beside those of the `pair`, and what mends it; empty where none is."""
    told = () if pair is None else pair.cameras
    late = [one for one in rig.cameras if one.offset and one.other not in told]
    if not late:
        return ""
    shown = [f"{one.other} is {_lateness(one)}" for one in late[:MOST_NAMED]]
    more = f", and {count(len(late) - MOST_NAMED, 'more camera')}" if len(late) > MOST_NAMED else ""
    # Shifts against two references do not go together.
    one_reference = pair is None or not pair.option or pair.reference == rig.reference
    options = " ".join(one.option for one in late if one.option and one_reference)
    mends = f" {options} pairs the pictures that belong together." if options else ""
    return f"Against {rig.reference}, {', '.join(shown)}{more} (by what moves; 95 %).{mends}"


def rig_lateness(timing: Timing) -> str:
    """A camera's lateness with its error; empty where that cannot be told."""
    return "" if timing.late_ms is None else _lateness(timing)


def rig_judgement(timing: Timing) -> str:
    """Whether a camera's pictures are of one instant with the reference's, in a few words."""
    if timing.synchronized:
        return "the same instant"
    if timing.offset:
        return timing.option or "not the same instant; no other pairing is nearer"
    return f"cannot be told: {timing.reason}"


def motion_sentence(timing: Timing) -> str:
    """That cameras moved while they recorded; empty where they did not."""
    moving = timing.moving_cameras
    if not moving:
        return ""
    who = "The cameras" if len(moving) > 1 else next(iter(moving))
    most = max(moving.values())
    far = f"by {most:.1f} pixels from frame to frame" if most < 1e3 else "further than can be followed"
    return (
        f"{who} moved while recording: nearly all that should stand still moves too, {far}. So "
        "nothing in these pictures is a control, and what is called moving is whatever changed most."
    )


def instant_lateness(late_ms: float, sd_ms: float) -> str:
    """One instant's own lateness with its 95 % error."""
    return f"{late_ms:+.1f} ± {2 * sd_ms:.1f} ms"


def late_or_early(late_ms: float, uncertainty_ms: float) -> str:
    """`0.4 ± 0.6 ms late`, or early."""
    return f"{abs(late_ms):.1f} ± {uncertainty_ms:.1f} ms {'early' if late_ms < 0 else 'late'}"


def _lateness(timing: Timing) -> str:
    assert timing.late_ms is not None
    assert timing.uncertainty_ms is not None
    return late_or_early(timing.late_ms, timing.uncertainty_ms)


def _offset(timing: Timing, by: str) -> str:
    if timing.late_ms is None:
        return (
            "These cameras were not synchronized: most of what moves is lost, and what is found of it lies "
            f"{timing.out_of_place_px:.0f} pixels off its rows, unlike what stands still. How many ms that "
            f"is could not be measured: {timing.reason}."
        )
    side = "earlier" if timing.late_ms < 0 else "later"
    if timing.by_depth:
        return (
            f"These cameras were not synchronized: {timing.other}'s pictures were taken about "
            f"{abs(timing.late_ms):.0f} ms {side} than {timing.reference}'s, as most depth is found then. "
            f"That is known to a frame only, because moving points do not tell: {timing.reason}."
        )
    size = _lateness(timing).rpartition(" ")[0]
    return (
        f"These cameras were not synchronized: {timing.other}'s pictures were taken {size} {side} than "
        f"{timing.reference}'s ({by}; 95 %)."
    )


def _odd(timing: Timing) -> str:
    return f" But {timing.reason}." if timing.reason and not _reason_is_told(timing) else ""


def _reason_is_told(timing: Timing) -> bool:
    return timing.by_depth or timing.late_ms is None


def _what_to_do(timing: Timing) -> str:
    if timing.option:
        return f"{timing.option} pairs the pictures that belong together."
    if timing.late_ms is None:
        return ""
    return "No other pairing of their pictures is nearer; it takes cameras that fire together."


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
