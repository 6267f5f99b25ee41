"""The two large numbers of a report, synchronized and offset, that say it all."""

from html import escape

from reconstruction.report import wording
from reconstruction.report.cells import meter
from reconstruction.scores.compare_results import CompareResult


def claims(result: CompareResult) -> str:
    """Two numbers, synchronized and offset, that say it all; nothing where there are none."""
    stereo, stitch = result.stereo, result.stitch
    sides = wording.sides(stereo.synced if stereo else None, result.actual_offset_ms)
    note = ""
    shown: tuple[tuple[str, str, float | None], ...]
    if stereo and None not in (stereo.synced.mover_within_2pct, stereo.offset.mover_within_2pct):
        what = "of the moving surface measured correctly"
        shown = _shares(stereo.synced.mover_within_2pct, stereo.offset.mover_within_2pct, what)
    elif stereo and None not in (stereo.synced.mover_coverage, stereo.offset.mover_coverage):
        what = "of the moving surface given a distance"
        note = "Nobody knows the true distances here, so this counts where the two pictures agree on one."
        shown = _shares(stereo.synced.mover_coverage, stereo.offset.mover_coverage, what)
    elif stitch:
        pair = (stitch.synced.mover_flow_p95_px, stitch.offset.mover_flow_p95_px)
        words = "of misfit of moving things where the pictures of the panorama overlap"
        if None in pair:
            pair = (stitch.synced.overlap_flow_p95_px, stitch.offset.overlap_flow_p95_px)
            words = "of misfit where the pictures of the panorama overlap"
        most = max(1e-9, *(value for value in pair if value is not None))
        shown = tuple((wording.quantity(v, "px"), words, None if v is None else v / most) for v in pair)
    else:
        return ""
    whens = (sides.when, f"when one picture is {sides.late}")
    both = zip(("synced", "offset"), shown, whens, strict=True)
    cards = '<div class="claims">' + "".join(_claim(*side) for side in both) + "</div>"
    return cards + (f'<p class="quiet">{note}</p>' if note else "")


def _shares(
    synced: float | None, offset: float | None, what: str
) -> tuple[tuple[str, str, float | None], ...]:
    return tuple((wording.share(value, decimals=0), what, value) for value in (synced, offset))


def _claim(side: str, shown: tuple[str, str, float | None], when: str) -> str:
    value, what, fraction = shown
    return (
        f'<p class="claim {side}"><strong>{escape(value)}</strong>{meter(fraction)} {escape(what)} '
        f'<span class="which">{escape(when)}</span></p>'
    )
