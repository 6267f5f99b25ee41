"""The part of a report on depth from all cameras at once: sliders, and the table with its control."""

from collections.abc import Mapping
from dataclasses import replace
from html import escape
from pathlib import Path

from reconstruction.report import wording
from reconstruction.report.cells import COVERAGE, EPIPOLAR, WITHIN, Head, listing
from reconstruction.report.pictures import figure
from reconstruction.report.tables import CORRECT, Measure, pixels, with_control
from reconstruction.scores.depth_results import MultiviewComparison


def measures(result: MultiviewComparison) -> tuple[Measure, ...]:
    """The rows of the table."""
    near = "" if result.tolerance_m is None else f" to within {100 * result.tolerance_m:.3g}{wording.GAP}cm"
    return (
        *CORRECT,
        Measure(
            "coverage",
            COVERAGE,
            "Share for which at least three cameras agree on a distance. More is better.",
        ),
        Measure(
            "consistency",
            "Found by others too",
            "Share whose distance two other cameras find, each for itself, before any other check. More is "
            "better.",
        ),
        Measure(
            "epipolar_px",
            EPIPOLAR,
            "How far what two cameras show of one point is off its line. Less is better.",
            pixels,
        ),
        Measure(
            "photometric",
            "Brightness mismatch",
            "The other pictures are laid over this one by the distances found; this is how far the "
            "brightness differs, of 255. Less is better.",
            wording.quantity,
        ),
        Measure(
            "points",
            "Points in space",
            "In the cloud fused from all cameras, of one instant on average.",
            wording.number,
        ),
        Measure(
            "f_score",
            "Surface rebuilt",
            f"How well the cloud and the true surface agree{near}: 100 % is all of it and nothing else "
            "(F-score). More is better.",
        ),
        Measure("precision", "Points that are right", f"Share of the points on a true surface{near}."),
        Measure("recall", "Surface with points", f"Share of the true surface that has a point{near}."),
    )


def apart(sides: wording.Sides) -> wording.Sides:
    """The names of the sides where every camera is off by another time."""
    return replace(sides, late=wording.APART)


def all_cameras_section(result: MultiviewComparison | None, out: Path, sides: wording.Sides) -> str:
    """The section; nothing where it was not measured. Raises BadInputError where a picture is missing."""
    if result is None:
        return ""
    figures = "\n".join(figure(picture, out, apart(sides)) for picture in result.pictures)
    count = wording.count(len(result.cameras), "camera")
    return f"""<section aria-labelledby="all-cameras">
<h2 id="all-cameras">With all cameras at once</h2>
<p>Distance from {count} at once: it counts only where several of them agree on it.
{escape(how_apart(result.offsets_ms, result.reference))}</p>
{figures}
{_table(result, sides)}
</section>"""


def _table(result: MultiviewComparison, sides: wording.Sides) -> str:
    caption = f"Depth from {wording.count(len(result.cameras), 'camera')}, as {result.reference} sees it"
    table = with_control(caption, measures(result), result.synced, result.offset, apart(sides))
    notes = [f"No depth of {camera}: {why}." for camera, why in result.left_out.items()]
    if result.cloud_skipped:
        notes.append(f"No points in space: {result.cloud_skipped}.")
    words = "".join(f'<p class="quiet">{escape(note)}</p>' for note in notes)
    return table + words + _instants(result, apart(sides))


def how_apart(offsets_ms: Mapping[str, float], reference: str) -> str:
    """How far the cameras are apart in time, in a sentence."""
    if not offsets_ms:
        return wording.tie("Apart: every camera is off by another time, up to 66 ms, drawn for each instant.")
    return f"Apart, against {reference}: {wording.offsets(offsets_ms)}."


_INSTANT = (
    ("mover_within_2pct", WITHIN, wording.share),
    ("mover_coverage", COVERAGE, wording.share),
    ("mover_points", "Points in space", wording.number),
)


def _instants(result: MultiviewComparison, sides: wording.Sides) -> str:
    columns = [
        column
        for column in _INSTANT
        if any(row.get(f"synced_{column[0]}") is not None for row in result.per_instant)
    ]
    if not columns:
        return ""
    tones = (("synced", sides.short), ("offset", sides.late_head))
    heads = [Head("Instant"), *(Head(side, name, tone) for _, name, _ in columns for tone, side in tones)]
    rows = [
        [
            f'<span class="narrow">Instant </span>{row["instant"]}',
            *(escape(show(row.get(f"{tone}_{key}"))) for key, _, show in columns for tone, _ in tones),
        ]
        for row in result.per_instant
    ]
    table = listing("Moving things, all cameras", heads, rows)
    return f"<details><summary>Every instant, all cameras</summary>\n{table}</details>\n"
