"""A comparison in words: the cameras' time offsets, the verdict, and its claims; sentences are templates."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from reconstruction.common import wording
from reconstruction.common.templates import render_sentences
from reconstruction.method.comparison_results import CompareResult
from reconstruction.method.phrases import EACH_DELAYED, LIMITS, UNSYNCHRONIZED, late_text
from reconstruction.method.score import Score, reported, study_reports
from reconstruction.method.study_result import StudyResult
from reconstruction.method.tally import CONDITIONS
from reconstruction.method.timing import SessionTiming, Timing
from reconstruction.method.words import Claim
from reconstruction.scene.calibration.consistency import INACCURATE_PX, describe_residual

VAGUE_FRACTION = 0.6
"""Width of a fraction's 95 % interval from which it is no headline."""


def sentences(template: str, **view: object) -> str:
    """Return the words of one of this room's templates."""
    return render_sentences(template, __package__, offset_text=offset_text, **view)


def rig_sentence(rig: SessionTiming, pair: Timing | None) -> str:
    """Return a sentence on cameras that are certainly offset, without the `pair`'s own; empty if none is."""
    paired = set() if pair is None else {*pair.cameras}
    late = [camera for camera in rig.cameras if camera.offset and {*camera.cameras} != paired]
    # Time shifts against two references cannot be combined.
    one_reference = pair is None or not pair.option or pair.reference == rig.reference
    options = [camera.option for camera in late if camera.option and one_reference]
    return sentences("rig.txt", reference=rig.reference, late=late, options=options) if late else ""


def offset_text(timing: Timing) -> str:
    """Return a camera's time offset with its error; empty if unknown."""
    known = timing.late_ms is not None and timing.uncertainty_ms is not None
    return wording.late_or_early(timing.late_ms or 0.0, timing.uncertainty_ms or 0.0) if known else ""


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
    """Return the cameras' delays as a sentence, or that they are drawn at random; empty for a pair."""
    reference = study_reports()[study.name].placeholders(study)["reference"]
    return sentences("delays.txt", study=study, reference=reference, each_delayed=EACH_DELAYED)


def verdict(result: CompareResult) -> str:
    """Return the comparison's verdict in a few sentences, for a reader who knows nothing of synchronization.

    Images are said to show one instant only if their timing was found to.
    """
    made = _believed(result)
    names = {found.name for _, found in made}
    recorded = [study.as_recorded(result, found) for study, found in made]
    clear = [study.verdict(result, found) for study, found in made if study.text.replaces not in names]
    return sentences(
        "verdict.txt",
        result=result,
        recorded=next((text for text in recorded if text is not None), None),
        clear=list(filter(None, clear)),
        is_measured=any(found.measures for _, found in reported(result)),
        # Roughly known lenses may hide a difference, but make none.
        lenses=result.lenses.doubt(rough=not any(clear)),
        late=late_text(result),
        rig=rig_sentence(result.rig_timing, result.timing) if result.rig_timing is not None else "",
        guess=result.lenses.text if result.lenses.is_guess else "",
        misfit=_residual_sentence(result),
        skipped=[
            f"{study_reports()[study.name].text.subject} ({study.skipped})"
            for study in result.studies
            if study.skipped and not study.unasked
        ],
        **LIMITS,
    )


def _believed(result: CompareResult) -> list[tuple[type[Score], StudyResult[Any]]]:
    """Return the studies from which a verdict may be made, each with its result."""
    return [made for made in reported(result) if not (result.lenses.doubt() and made[0].needs_calibration)]


def _residual_sentence(result: CompareResult) -> str:
    """Return a sentence on a calibration that points at rest do not fit; empty if they do."""
    px = result.rest_error_px
    if px is None or px < INACCURATE_PX or result.lenses.doubt():
        return ""
    text = describe_residual(px, result.rest_points, "calibrate the rig again")
    return f"{text[0].upper()}{text[1:]}."


def claims(result: CompareResult) -> tuple[Sequence[dict[str, object]], str]:
    """Return each condition's number and a note on both; empty if nothing was measured.

    `tone` is the condition; `value` is in words and `fraction` (0..1) is drawn. `what` says what the value
    measures, and `when` names the condition's images.
    """
    for study, found in _believed(result):
        claim = next((claim for claim in study.text.claims if found.first_known(claim.measure)), None)
        if claim is not None and not _is_vague(found, claim):
            return [*_claimed(found, claim, name_conditions(result, found.cameras))], claim.note
    return (), ""


def _claimed(found: StudyResult[Any], claim: Claim, names: ConditionNames) -> Iterator[dict[str, object]]:
    values = [found.value(claim.measure, side) or 0.0 for side in CONDITIONS]
    is_fraction = claim.unit == wording.PERCENT
    whole = 1.0 if is_fraction else max(1e-9, *values)
    whens = (names.when, f"when one picture is {names.late}")
    for tone, value, when in zip(CONDITIONS, values, whens, strict=True):
        text = wording.percentage(value, decimals=0) if is_fraction else wording.quantity(value, claim.unit)
        yield {"tone": tone, "value": text, "fraction": value / whole, "when": when, "what": claim.what}


def _is_vague(found: StudyResult[Any], claim: Claim) -> bool:
    """Return whether a claimed fraction's interval is too wide for a headline."""
    interval = found.interval(claim.measure)
    return (
        claim.unit == wording.PERCENT
        and interval is not None
        and interval.ends[1] - interval.ends[0] > VAGUE_FRACTION
    )


def exactness_view(result: CompareResult) -> dict[str, object]:
    """Return what the page says of the take's time error: the timing shown, with its offset in words.

    It is that of the camera that is furthest off (`is_offset`), else that of the pair.
    """
    rig = result.rig_timing.cameras if result.rig_timing is not None else ()
    known = [timing for timing in (result.timing, *rig) if timing is not None]
    furthest = max((timing for timing in known if timing.offset), key=_largest_offset_ms, default=None)
    shown = furthest or result.timing
    return {
        "shown": shown,
        "is_offset": furthest is not None,
        "late": offset_text(shown) if shown is not None else "",
        "largest_ms": _largest_offset_ms(shown) if shown is not None else 0.0,
    }


def _largest_offset_ms(timing: Timing) -> float:
    """Return the size of the offset; if it changes, the largest, of its instants or between two steps."""
    late_ms = [instant.late_ms for instant in timing.instants] if timing.change.drift else []
    for step in timing.change.steps:
        later = [moment.late_ms for moment in timing.instants if moment.instant >= step.instant]
        late_ms += [median(later)] if later else []
    return max(map(abs, [*late_ms, timing.late_ms or 0.0]))
