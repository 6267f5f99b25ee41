"""A comparison in words: the cameras' time offsets, the verdict, and its claims."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from capture_app.common.text import count
from reconstruction.common import wording
from reconstruction.method.comparison_results import CompareResult
from reconstruction.method.phrases import EACH_DELAYED, UNSYNCHRONIZED, late_or_early, late_text
from reconstruction.method.score import reported, study_reports
from reconstruction.method.study_result import StudyResult
from reconstruction.method.timing import SessionTiming, Timing
from reconstruction.method.words import Claim
from reconstruction.scene.calibration.consistency import INACCURATE_PX, describe_misfit
from reconstruction.scene.calibration.structure_from_motion import GUESS

VAGUE_FRACTION = 0.6
"""Width of a fraction's 95 % interval from which it is no headline."""
REPAIR = "To pair the pictures of an imported session again: reconstruct time --repair-drops"
MAX_NAMED = 4
"""Maximum number of cameras named in a sentence."""


def timing_sentences(timing: Timing) -> str:
    """Return the second camera's time offset and what to do about it, and what single images show."""
    single = timing.images.describe(timing.other, timing.reference)
    return " ".join([_offset_found(timing), *(f"{text}." for text in single)])


def _offset_found(timing: Timing) -> str:
    by = f"by what moves at {count(len(timing.instants), 'instant')}"
    if timing.offset:
        return _offset_sentences(timing, by)
    late = f"{timing.other} is {offset_text(timing)} against {timing.reference} ({by}; 95 %)"
    if timing.synchronized:
        return f"{late}: the same instant, within what these pictures show."
    below_ms = timing.same_frame_ms
    text = (
        "These pictures do not show whether the cameras were synchronized"
        if below_ms is None
        else f"These pictures are of the same frame. Offsets below {below_ms:.0f} ms cannot be measured"
    )
    return f"{text}: {timing.reason}." if timing.late_ms is None else f"{text}: {timing.reason}. {late}."


def _offset_sentences(timing: Timing, by: str) -> str:
    sentence, late_ms = "These cameras were not synchronized:", timing.late_ms
    if timing.planned_ms and late_ms is not None and not timing.change and timing.jitter_ms is None:
        return (
            f"{timing.other} is staggered by {timing.planned_ms:+.2f} ms on purpose, and is "
            f"{offset_text(timing)} against {timing.reference} ({by}; 95 %)."
        )
    if timing.change:
        if timing.change.steps:
            sentence = f"These cameras were not synchronized throughout: {timing.reason}; before that"
            return f"{sentence} it is {offset_text(timing)} ({by}; 95 %). {REPAIR}."
        sentence = f"{sentence} {timing.reason}, and {timing.other} is {offset_text(timing)} on average"
        return f"{sentence} ({by}; 95 %). Import it with its own times: --times or --timestamps."
    paired = f"{timing.option} pairs the pictures that belong together" if timing.option else ""
    if timing.jitter_ms is not None:
        shift = f" {paired} on average." if paired else ""
        return (
            f"{sentence} {timing.reason} against {timing.reference}'s ({by}; 95 %), {offset_text(timing)} on "
            f"average.{shift} Other pairs of pictures stay apart; it takes synchronized cameras."
        )
    if late_ms is None:
        return (
            f"{sentence} most of what moves is lost, and the rest is found "
            f"{timing.out_of_place_px:.0f} pixels off its rows, unlike things at rest. "
            f"The offset in ms could not be measured: {timing.reason}."
        )
    paired = paired or "No other pairing of their pictures is closer in time; it takes synchronized cameras"
    side = f"{'earlier' if late_ms < 0 else 'later'} than {timing.reference}'s"
    if timing.by_depth:
        return (
            f"{sentence} {timing.other}'s pictures were taken about {abs(late_ms):.0f} ms {side}, where most "
            f"depth is found. This is accurate to one frame only: {timing.reason}. {paired}."
        )
    size = offset_text(timing).rpartition(" ")[0]
    odd = f" But {timing.reason}." if timing.reason else ""
    return f"{sentence} {timing.other}'s pictures were taken {size} {side} ({by}; 95 %).{odd} {paired}."


def rig_sentence(rig: SessionTiming, pair: Timing | None) -> str:
    """Return a sentence on cameras besides the `pair` that are certainly offset; empty if none is."""
    paired = () if pair is None else pair.cameras
    late = [camera for camera in rig.cameras if camera.offset and camera.other not in paired]
    if not late:
        return ""
    shown = [
        camera.reason if camera.change else f"{camera.other} is {offset_text(camera)}"
        for camera in late[:MAX_NAMED]
    ]
    more = f", and {count(len(late) - MAX_NAMED, 'more camera')}" if len(late) > MAX_NAMED else ""
    # Time shifts against two references cannot be combined.
    one_reference = pair is None or not pair.option or pair.reference == rig.reference
    options = " ".join(camera.option for camera in late if camera.option and one_reference)
    remedy = f" {options} pairs the pictures that belong together." if options else ""
    return f"Against {rig.reference}, {', '.join(shown)}{more} (by what moves; 95 %).{remedy}"


def offset_text(timing: Timing) -> str:
    """Return a camera's time offset with its error; empty if unknown."""
    known = timing.late_ms is not None and timing.uncertainty_ms is not None
    return late_or_early(timing.late_ms or 0.0, timing.uncertainty_ms or 0.0) if known else ""


def rig_judgement(timing: Timing) -> str:
    """Return in a few words whether a camera shows the same instant as the reference."""
    if timing.synchronized:
        return "the same instant"
    if timing.change:
        return timing.reason
    if timing.offset:
        if timing.planned_ms:
            return f"staggered on purpose, by {timing.planned_ms:+.2f} ms"
        return timing.option or "not the same instant; no other pairing is closer in time"
    if timing.same_frame_ms is not None:
        return f"the same frame; offsets below {timing.same_frame_ms:.0f} ms are unknown"
    return f"unknown: {timing.reason}"


def motion_sentence(timing: Timing) -> str:
    """Return a sentence about cameras that moved while recording; empty if none did."""
    if not (moving := timing.moving_cameras):
        return ""
    max_px = max(moving.values())
    far = f"by {max_px:.1f} pixels from frame to frame" if max_px < 1e3 else "too far to be tracked"
    who = "The cameras" if len(moving) > 1 else next(iter(moving))
    return (
        f"{who} moved while recording: nearly all points at rest move too, {far}. So these pictures "
        "have no still control, and what is called moving is what changed most."
    )


@dataclass(frozen=True)
class ConditionNames:
    """Names of the two conditions of a comparison."""

    first: str
    when: str
    """Name of the first condition at the end of a sentence."""
    late: str
    heads: Mapping[str, str]
    """Each condition (`synced`, `offset`) with its column head."""
    apart: bool = False
    """Whether the images of the first condition were found to show different instants."""

    @property
    def late_head(self) -> str:
        """Name of the second condition at the beginning of a line."""
        return self.late[0].upper() + self.late[1:]


def name_conditions(result: CompareResult, cameras: Sequence[str] = ()) -> ConditionNames:
    """Return the conditions' names for these cameras; by default, for the pair whose timing was measured.

    Images are called synchronized only if they were found to show one instant. With more than two cameras,
    each camera has its own delay.
    """
    asked = cameras or (() if result.timing is None else result.timing.cameras)
    many = len(asked) > 2
    late = UNSYNCHRONIZED if many else wording.offset_text(result.actual_offset_ms)
    late_head = "Unsynced" if many else late[0].upper() + late[1:]
    if asked and result.together(asked):
        when = f"when {'all' if many else 'both'} pictures show the same instant"
        return ConditionNames("Synchronized", when, late, {"synced": "Synced", "offset": late_head})
    return ConditionNames(
        "As recorded",
        "in the pictures as they were recorded",
        late,
        {"synced": "Recorded", "offset": late_head},
        apart=result.apart(asked),
    )


def describe_delays(study: StudyResult[Any]) -> str:
    """Return the cameras' delays as a sentence; empty for a pair.

    Without known delays the sentence says that they are drawn at random.
    """
    if len(study.cameras) == 2:
        return ""
    if not study.offsets_ms:
        return f"Unsynchronized: {EACH_DELAYED} of up to 66 ms, drawn at random for each instant."
    reference = study_reports()[study.name].placeholders(study)["reference"]
    return f"Unsynchronized, relative to {reference}: {wording.delays(study.offsets_ms)}."


def verdict(result: CompareResult) -> str:
    """Return the comparison's verdict in a few sentences, for a reader who knows nothing of synchronization.

    Images are said to show one instant only if their timing was found to.
    """
    timing, rig = result.timing, result.rig_timing
    texts = (
        f"This recording is {result.unsynchronized}." if result.unsynchronized else "",
        f"This recording is {result.staggered}: its pictures show no one moment." if result.staggered else "",
        motion_sentence(timing) if timing is not None else "",
        _what_was_found(result),
        rig_sentence(rig, timing) if rig is not None else "",
        _guess_sentence(result),
        _misfit_sentence(result),
        _skipped_sentence(result),
    )
    return " ".join(filter(None, texts))


def _guess_sentence(result: CompareResult) -> str:
    """Return a sentence on a calibration that was estimated from images alone; empty for any other."""
    _, guess, errors = result.calibration.partition(GUESS)
    return f"The calibration is {guess}{errors}." if guess else ""


def _misfit_sentence(result: CompareResult) -> str:
    """Return a sentence on a calibration that points at rest do not fit; empty if they do."""
    px = result.rest_error_px
    if px is None or px < INACCURATE_PX:
        return ""
    text = describe_misfit(px, result.rest_points, "calibrate the rig again")
    return f"{text[0].upper()}{text[1:]}."


def _skipped_sentence(result: CompareResult) -> str:
    """Return a sentence on requested studies that could not be made, with reasons; empty if all were made."""
    skipped = [
        f"{study_reports()[study.name].text.subject} ({study.skipped})"
        for study in result.studies
        if study.skipped and not study.unasked
    ]
    return f"Not made: {'; '.join(skipped)}." if skipped else ""


def _what_was_found(result: CompareResult) -> str:
    timing, made = result.timing, reported(result)
    if timing is not None and timing.offset:
        recorded = (study.as_recorded(found) for study, found in made)
        if (text := next((study for study in recorded if study is not None), None)) is not None:
            return f"{timing_sentences(timing)} {text}".strip()
    names = {found.name for _, found in made}
    clear = (study.verdict(result, found) for study, found in made if study.text.replaces not in names)
    texts = list(filter(None, clear))
    if not texts and result.moving_share < 0.0005:
        return (
            "Almost nothing moves in this burst, so synchronization makes no visible "
            "difference. Take a burst of something that moves."
        )
    if not texts and not any(found.measures for _, found in made):
        return "Nothing could be measured with these cameras, so nothing can be compared."
    texts = texts or [_no_difference(timing, late_text(result))]
    return " ".join([*texts, *([timing_sentences(timing)] if timing is not None else [])])


def _no_difference(timing: Timing | None, late: str) -> str:
    if timing is not None and timing.synchronized:
        return (
            f"No clear difference was found between pictures of the same instant and pictures taken {late}: "
            "what moves here is too slow or too small for this delay."
        )
    if timing is not None and timing.same_frame_ms is not None:
        return (
            f"No clear difference was found between pictures of the same frame and pictures taken {late}: "
            "what moves here is too slow or too small for this delay."
        )
    return (
        f"No clear difference was found between the pictures as recorded and pictures taken {late}. "
        "What moves here is too slow or too small for this delay, or the recordings were not synchronized "
        "to begin with."
    )


def claims(result: CompareResult) -> tuple[Sequence[dict[str, object]], str]:
    """Return each condition's number and a note on both; empty if nothing was measured.

    `tone` is the condition; `value` is in words and `fraction` (0..1) is drawn. `what` says what the value
    measures, and `when` names the condition's images.
    """
    known = (
        (found, claim)
        for study, found in reported(result)
        if (claim := study.claim(found)) is not None and not _is_vague(found, claim)
    )
    shown, claim = next(known, (None, None))
    if shown is None or claim is None:
        return (), ""
    is_fraction = claim.unit == wording.PERCENT
    whole = 1.0 if is_fraction else max(1e-9, *claim.values)
    named = name_conditions(result, shown.cameras)
    whens = {"synced": named.when, "offset": f"when one picture is {named.late}"}
    found = [
        {
            "tone": tone,
            "value": wording.percentage(value, decimals=0)
            if is_fraction
            else wording.quantity(value, claim.unit),
            "fraction": value / whole,
            "when": when,
            "what": claim.what,
        }
        for (tone, when), value in zip(whens.items(), claim.values, strict=True)
    ]
    return found, claim.note


def _is_vague(found: StudyResult[Any], claim: Claim) -> bool:
    """Return whether a claimed fraction's interval is too wide for a headline."""
    known = (
        measure.synced
        for measure in found.measures
        if measure.synced and measure.synced.value == claim.values[0]
    )
    return claim.unit == wording.PERCENT and any(
        interval.ends[1] - interval.ends[0] > VAGUE_FRACTION for interval in known
    )


def describe_exactness(result: CompareResult) -> dict[str, str]:
    """Return this take's time `error` and the delay its motion tolerates (`tolerated`), with a `conclusion`.

    Both have a `*_source` that says how they were determined. Unknown values are stated as such.
    """
    offset = [timing for timing in timings_of(result) if timing.offset]
    furthest = max(offset, key=_largest_offset_ms, default=None)
    shown = furthest or result.timing
    measured = offset_text(shown) if shown is not None else ""
    if shown is not None and shown.change:
        measured = f"up to {wording.milliseconds(round(_largest_offset_ms(shown)))}"
    if result.sync_residual_us is not None and furthest is None:
        error, source = f"≤ {wording.microseconds(result.sync_residual_us)}", "by the session's own record"
        source += f"; {measured} by what moves" if measured else ""
    elif shown is not None and measured:
        error, source = measured, f"{shown.other} against {shown.reference}, by what moves"
        source = f"{shown.reason}, by what moves" if shown.change else source
    else:
        error = wording.NOT_AVAILABLE
        source = result.unsynchronized.partition(":")[0] or "neither recorded nor measured"
    together = furthest is None and result.timing is not None and result.timing.synchronized
    tolerated, tolerated_source, conclusion = _tolerated_delay(result, together=together)
    return {
        "error": error,
        "error_source": source,
        "tolerated": tolerated,
        "tolerated_source": tolerated_source,
        "conclusion": conclusion,
    }


def _largest_offset_ms(timing: Timing) -> float:
    """Return the size of the offset; if it changes, the largest, of its instants or between two steps."""
    late_ms = [instant.late_ms for instant in timing.instants] if timing.change.drift else []
    for step in timing.change.steps:
        later = [moment.late_ms for moment in timing.instants if moment.instant >= step.instant]
        late_ms += [median(later)] if later else []
    return max(map(abs, [*late_ms, timing.late_ms or 0.0]))


def timings_of(result: CompareResult) -> list[Timing]:
    """Return the judgements of the pair and of all cameras."""
    rig = result.rig_timing.cameras if result.rig_timing is not None else ()
    return [timing for timing in (result.timing, *rig) if timing is not None]


def _tolerated_delay(result: CompareResult, *, together: bool) -> tuple[str, str, str]:
    """Return the tolerated delay, its source, and how the take's own error compares with it."""
    tolerance, error_us = result.tolerance, result.sync_residual_us
    apart = any(timing.offset for timing in timings_of(result))
    unknown = {
        "whether the pictures show one instant was not measured": result.timing is None,
        "the pictures do not show one instant": apart,
        "whether the pictures show one instant is not certain": not together,
        "depth against delay was not measured": tolerance is None,
    }
    if tolerance is None or not together:
        return wording.NOT_AVAILABLE, next(why for why, holds in unknown.items() if holds), ""
    if tolerance.tolerable_offset_ms is None:
        max_ms = round(max(abs(point.late_ms or 0.0) for point in tolerance.points))
        return f"> {wording.milliseconds(max_ms)}", "less than a tenth of the depth is lost by then", ""
    tolerated_us = 1000 * tolerance.tolerable_offset_ms
    conclusion = ""
    if error_us is not None and tolerated_us < error_us:
        conclusion = "This take is not accurate enough for this motion."
    elif error_us is not None:
        conclusion = (
            f"{wording.times(tolerated_us / max(error_us, 1e-3))} more accurate than this motion needs."
        )
    why = "at this delay a tenth of the depth is lost, or half of what moves is off by a pixel"
    return wording.microseconds(tolerated_us), why, conclusion


def describe_synchronization(result: CompareResult) -> str:
    """Return the times between images and their instants, as the session recorded them."""
    residual, bound = (wording.microseconds(us) for us in (result.sync_residual_us, result.sync_bound_us))
    due = "planned time" if result.staggered else "instant"
    recorded = (
        result.staggered,
        f"every picture within {residual} of its {due}" if result.sync_residual_us is not None else "",
        f"the clocks agree to {bound} in the worst case" if result.sync_bound_us is not None else "",
    )
    known = "; ".join(filter(None, recorded)) or "not known: the session has no record of its clocks"
    return result.unsynchronized or known
