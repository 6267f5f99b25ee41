"""What was measured of a pair's timing, in words."""

from capture_app.text import count
from reconstruction.scores.timing import RigTiming, Timing

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
