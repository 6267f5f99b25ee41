"""The two large numbers of a report, synchronized and offset."""

from collections.abc import Sequence
from dataclasses import dataclass

from reconstruction.report import wording
from reconstruction.report.verdict import DEPTH_MEASURES, MISFIT_MEASURES, first_known
from reconstruction.scores.compare_results import CompareResult


@dataclass(frozen=True)
class Claim:
    """One condition's number: in words, as a share 0..1 to draw, of what, and in which pictures."""

    tone: str
    value: str
    share: float
    what: str
    when: str


def claims(result: CompareResult, sides: wording.Sides) -> tuple[Sequence[Claim], str]:
    """Both numbers and a note on them; none where nothing was measured."""
    stereo, stitch = result.stereo, result.stitch
    depth = first_known(stereo.synced, stereo.offset, *DEPTH_MEASURES) if stereo else None
    misfit = first_known(stitch.synced, stitch.offset, *MISFIT_MEASURES) if stitch else None
    note = ""
    if depth:
        measure, *shares = depth
        what = "of the moving surface measured correctly"
        if measure != DEPTH_MEASURES[0]:
            what = "of the moving surface given a distance"
            note = "The true distances are not known here, so this counts pixels where both pictures agree."
        shown = [wording.share(value, decimals=0) for value in shares]
    elif misfit:
        measure, *values = misfit
        moving = "of moving things " if measure == MISFIT_MEASURES[0] else ""
        what = f"of misfit {moving}where the pictures of the panorama overlap"
        shares = [value / max(1e-9, *values) for value in values]
        shown = [wording.quantity(value, "px") for value in values]
    else:
        return (), ""
    whens = (sides.when, f"when one picture is {sides.late}")
    both = zip(("synced", "offset"), shown, shares, whens, strict=True)
    return [Claim(tone, value, share, what, when) for tone, value, share, when in both], note
