"""The part of a report on where the cameras stand, found from single instants alone."""

from html import escape

from reconstruction.report import wording
from reconstruction.report.all_cameras import apart, how_apart
from reconstruction.report.tables import Measure, beside
from reconstruction.scores.pose_results import PoseComparison

WIDE, HIGH = 480, 220
LEFT, RIGHT, TOP, BOTTOM = 62, 10, 12, 48


def _degrees(value: float | None) -> str:
    if value is None:
        return wording.NOT_AVAILABLE
    return f"{value:.3g}°" if value >= 1 else f"{value:.2g}°"


def poses_section(result: PoseComparison | None, sides: wording.Sides) -> str:
    """The section; nothing where poses were not looked at."""
    if result is None:
        return ""
    names = apart(sides)
    right = _degrees(result.right_deg)
    measures = (
        Measure(
            "registered",
            "Cameras placed",
            f"Of {len(result.cameras)}, at an instant on average. More is better.",
            wording.quantity,
        ),
        Measure(
            "right_pairs",
            "Pairs placed right",
            f"Share of all pairs of cameras whose angle and direction are right to {right}. More is better.",
        ),
        Measure(
            "rotation_deg",
            "Wrong by, angle",
            "Of the angle between two cameras that were placed; half of the pairs are worse. Less is better.",
            _degrees,
        ),
        Measure(
            "direction_deg",
            "Wrong by, direction",
            "Of the direction from one camera to the other, likewise.",
            _degrees,
        ),
    )
    verdict = (
        "So much moves in these pictures that lateness puts the cameras into the wrong places."
        if result.harmed
        else "Enough stands still in these pictures to place the cameras as well when they are apart."
    )
    why = f" Looked at: {result.why}." if result.why else ""
    caption = f"Poses of {wording.count(len(result.cameras), 'camera')}, each instant by itself"
    table = beside(caption, measures, result.synced, result.offset, names)
    return f"""<section aria-labelledby="poses">
<h2 id="poses">Where the cameras stand</h2>
<p>Before anything can be measured, it must be known where the cameras stand. Here that is found from the
pictures of one instant alone, as it must be for cameras that are moved. {verdict}</p>
<div class="curve">{_plot(result, names)}
<div><p class="key"><span class="tag synced">{escape(names.first)}</span>
<span class="tag offset">{escape(names.late_head)}</span></p>
<p>{escape(how_apart(result.offsets_ms, result.cameras[0]))}</p>
<p class="quiet">{escape(wording.tie(f"Held against: {result.truth}.{why}"))}</p></div></div>
{table}
</section>"""


def _plot(result: PoseComparison, sides: wording.Sides) -> str:
    """Two bars for each instant: the share of pairs that were placed right."""
    count = len(result.per_instant)
    if not count:
        return ""
    step = (WIDE - LEFT - RIGHT) / count
    thick = min(28.0, step * 0.36)
    parts = [
        f'<path d="M{LEFT} {_y(share):.1f}H{WIDE - RIGHT}" stroke="var(--line)"/>'
        f'<text x="{LEFT - 8}" y="{_y(share) + 5:.1f}" text-anchor="end">{100 * share:.0f} %</text>'
        for share in (0, 0.5, 1)
    ]
    told = []
    for place, row in enumerate(result.per_instant):
        middle = LEFT + step * (place + 0.5)
        words = []
        for tone, name, left in (("synced", sides.first, -1.0), ("offset", sides.late, 0.0)):
            share = float(row.get(f"{tone}_right_pairs") or 0.0)
            top = min(_y(share), _y(0) - 2)
            parts.append(
                f'<rect x="{middle + left * (thick + 1):.1f}" y="{top:.1f}" width="{thick:.1f}" '
                f'height="{_y(0) - top:.1f}" fill="var(--{tone})"/>'
            )
            words.append(f"{name.lower()} {wording.share(share, decimals=0)}")
        parts.append(
            f'<text x="{middle:.1f}" y="{HIGH - BOTTOM + 20}" text-anchor="middle">{row["instant"]}</text>'
        )
        told.append(f"instant {row['instant']}: {', '.join(words)}")
    middle = (LEFT + WIDE - RIGHT) / 2
    label = escape(f"Share of pairs placed right; {'; '.join(told)}")
    return f"""<svg class="dose" viewBox="0 0 {WIDE} {HIGH}" role="img" aria-label="{label}">
{"".join(parts)}
<text x="{middle}" y="{HIGH - 6}" text-anchor="middle">pairs placed right, by instant</text>
</svg>"""


def _y(share: float) -> float:
    return HIGH - BOTTOM - (HIGH - TOP - BOTTOM) * share
