"""What a comparison found, in words: the only place where figures become sentences."""

from collections.abc import Sequence
from dataclasses import dataclass

from capture_app.common.text import count
from reconstruction.calibration.structure_from_motion import GUESS
from reconstruction.report import wording
from reconstruction.scores.comparison_results import CompareResult
from reconstruction.scores.study_result import StudyResult
from reconstruction.scores.timing import RigTiming, Timing, found_shares

UNSYNCHRONIZED = "unsynchronized"
EACH_DELAYED = "each camera off by a different delay"
"""The condition of the studies of all cameras, in a word and in words."""
DEPTH_MEASURES = ("mover_within_2pct", "mover_coverage")
"""What depth is judged by: correct distances where the truth is known, else any distance."""
PANORAMA_MEASURES = ("mover_misfit_px", "mover_found")
"""What a panorama is judged by: how far off what moves is, else how much of it is found again at all."""
CLEAR_SHARE = 0.15
"""A loss of this share of the moving pixels is reported as clear."""
CLEAR_RATIO = 1.5
FALLEN_CONTROL = 0.1
"""A loss of this share of what stands still has another reason than timing."""
MOST_NAMED = 4
"""Cameras that are named in a sentence."""


def timing_sentences(timing: Timing) -> str:
    """How late the second camera is and what to do about it, or why that is not known."""
    by = f"by what moves at {count(len(timing.instants), 'instant')}"
    if timing.offset:
        return _offset_sentences(timing, by)
    late = f"{timing.other} is {lateness(timing)} against {timing.reference} ({by}; 95 %)"
    if timing.synchronized:
        return f"{late}: the same instant, as far as these pictures can tell."
    told = f"Whether these cameras were synchronized cannot be told from these pictures: {timing.reason}."
    if timing.same_frame_ms is not None:
        told = (
            "These pictures are of the same frame. Finer than "
            f"{timing.same_frame_ms:.0f} ms cannot be told: {timing.reason}."
        )
    return told if timing.late_ms is None else f"{told} {late}."


def _offset_sentences(timing: Timing, by: str) -> str:
    told, late_ms = "These cameras were not synchronized:", timing.late_ms
    if late_ms is None:
        return (
            f"{told} most of what moves is lost, and what is found of it lies "
            f"{timing.out_of_place_px:.0f} pixels off its rows, unlike what stands still. How many ms that "
            f"is could not be measured: {timing.reason}."
        )
    pairs = "No other pairing of their pictures is nearer; it takes cameras that fire together."
    if timing.option:
        pairs = f"{timing.option} pairs the pictures that belong together."
    side = f"{'earlier' if late_ms < 0 else 'later'} than {timing.reference}'s"
    if timing.by_depth:
        return (
            f"{told} {timing.other}'s pictures were taken about {abs(late_ms):.0f} ms {side}, as most depth "
            "is found then. That is known to a frame only, because moving points do not tell: "
            f"{timing.reason}. {pairs}"
        )
    size = lateness(timing).rpartition(" ")[0]
    odd = f" But {timing.reason}." if timing.reason else ""
    return f"{told} {timing.other}'s pictures were taken {size} {side} ({by}; 95 %).{odd} {pairs}"


def rig_sentence(rig: RigTiming, pair: Timing | None) -> str:
    """Which cameras are certainly late beside those of the `pair`, and what mends it; empty where none is."""
    told = () if pair is None else pair.cameras
    late = [one for one in rig.cameras if one.offset and one.other not in told]
    if not late:
        return ""
    shown = [f"{one.other} is {lateness(one)}" for one in late[:MOST_NAMED]]
    more = f", and {count(len(late) - MOST_NAMED, 'more camera')}" if len(late) > MOST_NAMED else ""
    # Shifts against two references do not go together.
    one_reference = pair is None or not pair.option or pair.reference == rig.reference
    options = " ".join(one.option for one in late if one.option and one_reference)
    mends = f" {options} pairs the pictures that belong together." if options else ""
    return f"Against {rig.reference}, {', '.join(shown)}{more} (by what moves; 95 %).{mends}"


def lateness(timing: Timing) -> str:
    """A camera's lateness with its error; empty where that cannot be told."""
    if timing.late_ms is None or timing.uncertainty_ms is None:
        return ""
    return late_or_early(timing.late_ms, timing.uncertainty_ms)


def rig_judgement(timing: Timing) -> str:
    """Whether a camera's pictures are of one instant with the reference's, in a few words."""
    if timing.synchronized:
        return "the same instant"
    if timing.offset:
        return timing.option or "not the same instant; no other pairing is nearer"
    if timing.same_frame_ms is not None:
        return f"the same frame; finer than {timing.same_frame_ms:.0f} ms cannot be told"
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


@dataclass(frozen=True)
class Sides:
    """What the two sides of a comparison are called."""

    first: str
    short: str
    """The first side where there is little room."""
    when: str
    """The first side at the end of a sentence."""
    late: str
    late_short: str
    """The second side at the head of a column."""
    apart: bool = False
    """Whether the pictures of the first side were found not to be of one instant."""

    @property
    def late_head(self) -> str:
        """The second side at the beginning of a line."""
        return self.late[0].upper() + self.late[1:]

    @property
    def heads(self) -> tuple[tuple[str, str], tuple[str, str]]:
        """Each condition (`synced`, `offset`) and the head of its column."""
        return ("synced", self.short), ("offset", self.late_short)


def name_sides(result: CompareResult, cameras: Sequence[str] = ()) -> Sides:
    """The names for what is shown of these cameras; without any, of the pair whose timing was measured.

    Only pictures that were found to be of one instant are called synchronized. Of more than two cameras,
    each has a delay of its own.
    """
    asked = cameras or (() if result.timing is None else result.timing.cameras)
    late = UNSYNCHRONIZED if len(asked) > 2 else wording.lateness(result.actual_offset_ms)
    late_short = "Unsynced" if len(asked) > 2 else late[0].upper() + late[1:]
    if asked and result.together(asked):
        many = "all" if len(asked) > 2 else "both"
        return Sides(
            "Synchronized", "Synced", f"when {many} pictures show the same instant", late, late_short
        )
    when = "in the pictures as they were recorded"
    return Sides("As recorded", "Recorded", when, late, late_short, apart=result.apart(asked))


def describe_delays(study: StudyResult) -> str:
    """How late each camera is, in a sentence; without numbers, drawn at random; empty of a pair."""
    if len(study.cameras) == 2:
        return ""
    if not study.offsets_ms:
        return f"Unsynchronized: {EACH_DELAYED} of up to 66 ms, drawn at random for each instant."
    reference = study.facts.get("reference", study.cameras[0])
    return f"Unsynchronized, relative to {reference}: {wording.delays(study.offsets_ms)}."


def verdict(result: CompareResult) -> str:
    """A few sentences for somebody who has never heard of synchronization.

    Pictures are said to be of one instant only where their timing was found to be so.
    """
    timing, rig = result.timing, result.rig_timing
    told = (
        f"This recording is {result.unsynchronized}." if result.unsynchronized else "",
        motion_sentence(timing) if timing is not None else "",
        _what_was_found(result),
        rig_sentence(rig, timing) if rig is not None else "",
        _guess_sentence(result),
        _skipped_sentence(result),
    )
    return " ".join(text for text in told if text)


def _guess_sentence(result: CompareResult) -> str:
    """That the calibration rests on pictures alone, and how far off it may be; empty where it does not."""
    _, guess, errors = result.calibration.partition(GUESS)
    return f"The calibration is {guess}{errors}." if guess else ""


def _skipped_sentence(result: CompareResult) -> str:
    """What could not be made, and why; empty where all that was asked for was."""
    skipped = [f"{one.subject} ({one.skipped})" for one in result.studies if one.skipped and not one.unasked]
    return f"Not made: {'; '.join(skipped)}." if skipped else ""


def _what_was_found(result: CompareResult) -> str:
    late, timing = f"{result.actual_offset_ms:.0f} ms late", result.timing
    stereo, multiview = result.study("stereo"), result.study("multiview")
    if stereo is not None and timing is not None and timing.offset:
        return f"{timing_sentences(timing)} {_as_recorded(stereo)}".strip()
    clear = [
        _stereo_sentence(result, stereo, late) if stereo else _multiview_sentence(result, multiview),
        _panorama_sentence(result, late),
        _pose_sentence(result),
    ]
    told = [text for text in clear if text]
    if not told:
        if result.moving_share < 0.0005:
            return (
                "Almost nothing moves in this burst, so synchronization makes no difference that can be "
                "seen. Take a burst of something that moves."
            )
        if not stereo and not multiview and not result.study("panorama"):
            return (
                "Neither depth nor a panorama could be made from these cameras, so nothing can be compared."
            )
        told = [_no_difference(timing, late)]
    return " ".join([*told, *([timing_sentences(timing)] if timing is not None else [])])


def _no_difference(timing: Timing | None, late: str) -> str:
    if timing is not None and timing.synchronized:
        return (
            f"No clear difference was found between pictures of the same instant and pictures taken {late}: "
            "what moves here is too slow or too small for this delay."
        )
    return (
        f"No clear difference was found between the pictures as recorded and pictures taken {late}. "
        "What moves here is too slow or too small for this delay, or the recordings were not synchronized "
        "to begin with."
    )


def _as_recorded(stereo: StudyResult) -> str:
    """What is found of what moves and of what stands still in the pictures as they were recorded."""
    moving, still = found_shares(stereo)
    if moving is None or still is None:
        return ""
    what = "a distance is" if stereo.value("mover_within_2pct") is None else "the right distance is"
    return (
        f"In the pictures as they were recorded, {what} found for {_percent(moving)} of what moves and for "
        f"{_percent(still)} of what stands still."
    )


def _stereo_sentence(result: CompareResult, stereo: StudyResult, late: str) -> str:
    """As `_depth_sentence`, with what stands still: a control, unless the cameras moved."""
    together = result.together(stereo.cameras)
    recorded = "both pictures show the same instant" if together else "the pictures are paired as recorded"
    first = _depth_sentence(stereo, recorded, f"one picture {late}", "both pictures agree on")
    still = stereo.first_known("static_coverage")
    if not first or still is None:
        return first
    moved = result.timing is not None and bool(result.timing.moving_cameras)
    lost = still[1] - still[2]
    if lost > FALLEN_CONTROL:
        return (
            f"{first} What stands still is found less often too ({_percent(still[1])} and "
            f"{_percent(still[2])}): timing is not all that differs."
            f"{'' if moved else ' Did the cameras move, or the light change?'}"
        )
    if moved or abs(lost) > 0.02:
        return first
    return (
        f"{first} What stands still is found equally well both times, so timing alone makes the difference."
    )


def _multiview_sentence(result: CompareResult, multiview: StudyResult | None) -> str:
    if multiview is None:
        return ""
    cameras, when = f"all {len(multiview.cameras)} cameras", "the pictures of {} are paired as recorded"
    if result.together(multiview.cameras):
        when = "{} show the same instant"
    return _depth_sentence(multiview, when.format(cameras), EACH_DELAYED, "several cameras agree on")


def _depth_sentence(depth: StudyResult, when: str, late: str, agreed: str) -> str:
    """How much of what moves is found in both conditions; empty where that is not clearly less when late."""
    known = depth.first_known(*DEPTH_MEASURES)
    if known is None or known[1] - known[2] < CLEAR_SHARE:
        return ""
    measure, synced, offset = known
    correct = measure == DEPTH_MEASURES[0]
    what = "the right distance is found" if correct else f"a distance is found that {agreed}"
    return f"When {when}, {what} for {_percent(synced)} of what moves; with {late}, for {_percent(offset)}."


def _panorama_sentence(result: CompareResult, late: str) -> str:
    panorama = result.study("panorama")
    if panorama is None:
        return ""
    when = "at the same instant" if result.together(panorama.cameras) else "as recorded"
    misfit = panorama.first_known(PANORAMA_MEASURES[0])
    if misfit is not None and misfit[2] >= max(CLEAR_RATIO * misfit[1], misfit[1] + 1.0):
        return (
            f"In the panorama, what moves fits together to within {misfit[1]:.1f} pixels {when}, "
            f"and is off by {misfit[2]:.0f} with one picture {late}."
        )
    found = panorama.first_known(PANORAMA_MEASURES[1])
    if found is None or found[1] - found[2] < CLEAR_SHARE:
        return ""
    return (
        f"Where the pictures of the panorama overlap, {_percent(found[1])} of what moves is in both {when}, "
        f"and {_percent(found[2])} with one picture {late}."
    )


def _pose_sentence(result: CompareResult) -> str:
    """Empty where delays do not harm the poses, since what stands still places the cameras both times."""
    poses = result.study("poses")
    before = poses.value("rotation_deg") if poses is not None and poses.facts["degraded"] else None
    if poses is None or before is None:
        return ""
    after = poses.value("rotation_deg", "offset")
    if after is None:
        wrong = "no camera can be placed"
    elif before > 0.5 * after:
        right = poses.value("correct_pairs", "offset") or 0.0
        wrong = f"only {_percent(right)} of the pairs are placed correctly"
    else:
        wrong = f"these angles are wrong by {after:.0f} degrees"
    pictures = "pictures of one instant" if result.together(poses.cameras) else "the pictures as recorded"
    return (
        f"So much moves here that it decides where the cameras seem to stand: {pictures} give "
        f"the angles between them to {before:.1g} degrees; with {EACH_DELAYED}, {wrong}."
    )


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.01 or share == 0 else "under 1 %"


def describe_control(result: CompareResult) -> str:
    """Whether timing alone can explain the difference: by the control, what stands still."""
    stereo = result.study("stereo")
    if stereo is None:
        return ""
    if result.timing is not None and result.timing.moving_cameras:
        return "The cameras moved while they recorded, so nothing in the pictures is a control."
    still = stereo.first_known("static_within_2pct", "static_coverage")
    if still is None:
        return ""
    values = f"({wording.share(still[1])} and {wording.share(still[2])})"
    if abs(still[1] - still[2]) >= 0.02:
        return (
            f"Things at rest are the control, and here they differ too {values}: not all of the difference "
            "comes from timing."
        )
    equal = f"Things at rest are the control: they are measured equally well in both {values}"
    moving = stereo.first_known(*DEPTH_MEASURES)
    if moving is None or moving[1] - moving[2] < CLEAR_SHARE:
        return f"{equal}."
    return f"{equal}, so the difference on moving things comes from timing alone."


def claims(result: CompareResult) -> tuple[Sequence[dict[str, object]], str]:
    """Each condition's number and a note on both; none where nothing was measured.

    A number's `tone` is its condition; `value` is in words, `share` (0..1) to be drawn, `what` it is of, and
    `when`: in which pictures.
    """
    stereo, panorama = result.study("stereo"), result.study("panorama")
    shown = stereo if stereo is not None and stereo.first_known(*DEPTH_MEASURES) else panorama
    known = None if shown is None else shown.first_known(*DEPTH_MEASURES, *PANORAMA_MEASURES)
    if shown is None or known is None:
        return (), ""
    measure, *values = known
    what = {
        "mover_within_2pct": "of the moving surface measured correctly",
        "mover_coverage": "of the moving surface given a distance",
        "mover_misfit_px": "of misfit of moving things where the pictures of the panorama overlap",
        "mover_found": "of moving things in both pictures where these overlap in the panorama",
    }[measure]
    note, shares = "", values
    words = [wording.share(value, decimals=0) for value in values]
    if measure == "mover_coverage":
        note = "The true distances are not known here, so this counts pixels where both pictures agree."
    elif measure == "mover_misfit_px":
        shares = [value / max(1e-9, *values) for value in values]
        words = [wording.quantity(value, "px") for value in values]
    sides = name_sides(result, shown.cameras)
    whens = (sides.when, f"when one picture is {sides.late}")
    both = zip(("synced", "offset"), words, shares, whens, strict=True)
    names = "tone", "value", "share", "when"
    return [{**dict(zip(names, one, strict=True)), "what": what} for one in both], note


def describe_exactness(result: CompareResult) -> dict[str, str]:
    """This take's `error` beside the lateness that its motion `bears`, each with its `*_source`: what it
    rests on; and the `conclusion`. What is not known is said."""
    rig = result.rig_timing.cameras if result.rig_timing is not None else ()
    offset = [one for one in (result.timing, *rig) if one is not None and one.offset]
    furthest = max(offset, key=lambda one: abs(one.late_ms or 0.0), default=None)
    shown = furthest or result.timing
    error, source, measured = wording.NOT_AVAILABLE, "neither recorded nor measured", ""
    if result.unsynchronized:
        source = result.unsynchronized.partition(":")[0]
    if shown is not None and (measured := lateness(shown)):
        error = measured
        source = f"{shown.other} against {shown.reference}, by what moves"
    if result.sync_residual_us is not None and furthest is None:
        error, source = f"≤ {wording.microseconds(result.sync_residual_us)}", "by the session's own record"
        source += f"; {measured} by what moves" if measured else ""
    together = furthest is None and result.timing is not None and result.timing.synchronized
    bears, bears_source, conclusion = _what_the_motion_bears(result, together=together)
    return {
        "error": error,
        "error_source": source,
        "bears": bears,
        "bears_source": bears_source,
        "conclusion": conclusion,
    }


def _what_the_motion_bears(result: CompareResult, *, together: bool) -> tuple[str, str, str]:
    """The delay, what it rests on, and how the take's own error compares with it."""
    tolerance, error_us = result.tolerance, result.sync_residual_us
    if not together:
        unmeasured = "whether the pictures are of one instant was not measured"
        why = unmeasured if result.timing is None else "the pictures were not found to be of one instant"
        return wording.NOT_AVAILABLE, why, ""
    if tolerance is None:
        return wording.NOT_AVAILABLE, "depth against delay was not measured", ""
    if tolerance.tolerable_offset_ms is None:
        most = max(abs(point.late_ms or 0.0) for point in tolerance.points)
        least = f"> {wording.milliseconds(round(most))}"
        return least, "less than a tenth of the depth is lost by then", ""
    bears_us = 1000 * tolerance.tolerable_offset_ms
    conclusion = ""
    if error_us is not None:
        ratio = bears_us / max(error_us, 1e-3)
        conclusion = f"{wording.times(ratio)} more exact than this motion needs."
        if ratio < 1:
            conclusion = "This take is not exact enough for this motion."
    why = "then a tenth of the depth is lost, or half of what moves is off by a pixel"
    return wording.microseconds(bears_us), why, conclusion


def describe_synchronization(result: CompareResult) -> str:
    """How far images are from their instants, by the session's record."""
    parts = []
    if result.sync_residual_us is not None:
        parts.append(f"every picture within {wording.microseconds(result.sync_residual_us)} of its instant")
    if result.sync_bound_us is not None:
        parts.append(f"the clocks agree to {wording.microseconds(result.sync_bound_us)} in the worst case")
    recorded = "; ".join(parts) or "not known: the session has no record of its clocks"
    return result.unsynchronized or recorded
