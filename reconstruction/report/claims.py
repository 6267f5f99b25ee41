"""The two large numbers of a report, synchronized and offset."""

from collections.abc import Sequence
from dataclasses import dataclass

from reconstruction.report import wording
from reconstruction.scores.compare_results import CompareResult


@dataclass(frozen=True)
class Claim:
    """One condition's number: in words, as a share 0..1 to draw, of what, and in which pictures."""

    tone: str
    value: str
    share: float | None
    what: str
    when: str


def claims(result: CompareResult, sides: wording.Sides) -> tuple[Sequence[Claim], str]:
    """Both numbers and a note on them; none where nothing was measured."""
    stereo, stitch = result.stereo, result.stitch
    note = ""
    if stereo and None not in (stereo.synced.mover_within_2pct, stereo.offset.mover_within_2pct):
        what = "of the moving surface measured correctly"
        values = shares = [stereo.synced.mover_within_2pct, stereo.offset.mover_within_2pct]
        shown = [wording.share(value, decimals=0) for value in values]
    elif stereo and None not in (stereo.synced.mover_coverage, stereo.offset.mover_coverage):
        what = "of the moving surface given a distance"
        note = "The true distances are not known here, so this counts pixels where both pictures agree."
        values = shares = [stereo.synced.mover_coverage, stereo.offset.mover_coverage]
        shown = [wording.share(value, decimals=0) for value in values]
    elif stitch:
        what = "of misfit of moving things where the pictures of the panorama overlap"
        values = [stitch.synced.mover_flow_p95_px, stitch.offset.mover_flow_p95_px]
        if None in values:
            what = "of misfit where the pictures of the panorama overlap"
            values = [stitch.synced.overlap_flow_p95_px, stitch.offset.overlap_flow_p95_px]
        most = max(1e-9, *(value for value in values if value is not None))
        shares = [None if value is None else value / most for value in values]
        shown = [wording.quantity(value, "px") for value in values]
    else:
        return (), ""
    whens = (sides.when, f"when one picture is {sides.late}")
    both = zip(("synced", "offset"), shown, shares, whens, strict=True)
    return [Claim(tone, value, share, what, when) for tone, value, share, when in both], note
