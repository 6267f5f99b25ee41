"""The first screen of a report: what it is of, how exact the take was, and what its motion bears."""

from collections.abc import Sequence
from dataclasses import dataclass

from capture_app.text import count
from reconstruction.report import wording
from reconstruction.report.timing_words import late_or_early
from reconstruction.report.verdict import DEPTH_MEASURES, PANORAMA_MEASURES, first_known
from reconstruction.scores.compare_results import CompareResult
from reconstruction.scores.timing import Timing

ORIGINS = {
    "simulated": ("Simulated", "pictures and true distances are rendered"),
    "captured": ("Captured", "pictures by this rig's cameras"),
    "imported": ("Imported", "recordings made elsewhere"),
}


@dataclass(frozen=True)
class Claim:
    """One condition's number: in words, as a share 0..1 to draw, of what, and in which pictures."""

    tone: str
    value: str
    share: float
    what: str
    when: str


@dataclass(frozen=True)
class Origin:
    """Where the pictures come from: in a word, and what is of them in a line."""

    word: str
    words: str


@dataclass(frozen=True)
class Exactness:
    """This take's error beside the lateness that its motion bears, each with what it rests on."""

    error: str
    error_source: str
    bears: str
    bears_source: str
    conclusion: str


def describe_origin(result: CompareResult) -> Origin | None:
    """None where the result does not say, as of older programs."""
    if result.origin not in ORIGINS:
        return None
    word, words = ORIGINS[result.origin]
    size = f"{count(result.camera_count, 'camera')}, {count(result.instant_count, 'instant')}"
    return Origin(word, f"{size}; {words}")


def describe_exactness(result: CompareResult) -> Exactness:
    """What is known of the take's error and of its motion; what is not known is said."""
    timing, dose = result.timing, result.dose
    apart = _furthest_apart(result)
    shown = apart or timing
    error, source, measured = wording.NOT_AVAILABLE, "neither recorded nor measured", ""
    if result.unsynchronized:
        source = result.unsynchronized.partition(":")[0]
    if shown is not None and shown.late_ms is not None and shown.uncertainty_ms is not None:
        error = measured = late_or_early(shown.late_ms, shown.uncertainty_ms)
        source = f"{shown.other} against {shown.reference}, by what moves"
    if result.sync_residual_us is not None and apart is None:
        error, source = f"≤ {wording.microseconds(result.sync_residual_us)}", "by the session's own record"
        if measured:
            source += f"; {measured} by what moves"
    together = apart is None and timing is not None and timing.synchronized
    if not together:
        bears, why = wording.NOT_AVAILABLE, "the pictures were not found to be of one instant"
        if timing is None:
            why = "whether the pictures are of one instant was not measured"
    elif dose is None:
        bears, why = wording.NOT_AVAILABLE, "depth against delay was not measured"
    elif dose.tolerable_offset_ms is None:
        most = max(abs(point.offset_ms) for point in dose.points)
        bears, why = (
            f"> {wording.milliseconds(round(most))}",
            "less than a tenth of the depth is lost by then",
        )
    else:
        bears = wording.microseconds(1000 * dose.tolerable_offset_ms)
        why = "then a tenth of the depth is lost, or half of what moves is off by a pixel"
    return Exactness(error, source, bears, why, _conclude(result, together=together))


def _furthest_apart(result: CompareResult) -> Timing | None:
    """Of the cameras that were found not to be of one instant with another the one that is furthest off."""
    rig = result.rig_timing.cameras if result.rig_timing is not None else ()
    known = [one for one in (result.timing, *rig) if one is not None and one.offset]
    return max(known, key=lambda one: abs(one.late_ms or 0.0), default=None)


def _conclude(result: CompareResult, *, together: bool) -> str:
    dose, error_us = result.dose, result.sync_residual_us
    if not together or dose is None or dose.tolerable_offset_ms is None or error_us is None:
        return ""
    ratio = 1000 * dose.tolerable_offset_ms / max(error_us, 1e-3)
    if ratio < 1:
        return "This take is not exact enough for this motion."
    return f"{wording.times(ratio)} more exact than this motion needs."


def claims(result: CompareResult) -> tuple[Sequence[Claim], str]:
    """Both numbers and a note on them; none where nothing was measured."""
    stereo, stitch = result.stereo, result.stitch
    depth = first_known(stereo.synced, stereo.offset, *DEPTH_MEASURES) if stereo else None
    found = first_known(stitch.synced, stitch.offset, *PANORAMA_MEASURES) if stitch else None
    note = ""
    cameras = stereo.cameras if stereo and depth else stitch.cameras if stitch else ()
    sides = wording.name_sides(result, cameras)
    if depth:
        measure, *shares = depth
        what = "of the moving surface measured correctly"
        if measure != DEPTH_MEASURES[0]:
            what = "of the moving surface given a distance"
            note = "The true distances are not known here, so this counts pixels where both pictures agree."
        shown = [wording.share(value, decimals=0) for value in shares]
    elif found and found[0] == PANORAMA_MEASURES[0]:
        _, *values = found
        what = "of misfit of moving things where the pictures of the panorama overlap"
        shares = [value / max(1e-9, *values) for value in values]
        shown = [wording.quantity(value, "px") for value in values]
    elif found:
        _, *shares = found
        what = "of moving things in both pictures where these overlap in the panorama"
        shown = [wording.share(value, decimals=0) for value in shares]
    else:
        return (), ""
    whens = (sides.when, f"when one picture is {sides.late}")
    both = zip(("synced", "offset"), shown, shares, whens, strict=True)
    return [Claim(tone, value, share, what, when) for tone, value, share, when in both], note
