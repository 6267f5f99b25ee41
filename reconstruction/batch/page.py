"""A batch's summary as a page for people, in the look of the reports."""

from html import escape

from reconstruction.batch.plan import RESULT
from reconstruction.batch.rows import BatchResult, Group, Row
from reconstruction.report import wording
from reconstruction.report.cells import Head, listing
from reconstruction.report.frame import fill_page

_SHARES = {
    "coverage": "Given a distance",
    "within_2pct": "Measured correctly",
    "mover_within_2pct": "Moving: measured correctly",
    "static_within_2pct": "At rest: measured correctly",
}
_HEADS = (*_SHARES.values(), "Median error", "Points in space")


def summary_page(result: BatchResult) -> str:
    """The whole page. Holds no times and no durations."""
    made = len(result.units) - result.failed
    failed = f", {result.failed} failed" if result.failed else ""
    verdict = f"{wording.count(made, 'unit')} made{failed}"
    groups = listing(
        "Medians over the instants",
        [Head("Session and condition"), Head("Instants"), *map(Head, _HEADS)],
        [[_name(group), _instants(group), *_figures(group)] for group in result.groups],
    )
    units = listing(
        "Every unit",
        [Head("Session and condition"), Head("Instant"), *map(Head, _HEADS)],
        [[_unit(row), _instant(row), *_figures(row)] for row in result.units if not row.problem],
    )
    lost = "".join(
        f"<dt>{_unit(row)}</dt><dd>{escape(row.problem)}</dd>" for row in result.units if row.problem
    )
    problems = f'<section><h2>What failed</h2><dl class="making">{lost}</dl></section>' if lost else ""
    words = f"""<section>
<p>The figures are those of each instant's reference camera. Measured correctly: within 2{wording.GAP}% of
the true distance, where that is known; what was given none counts as wrong.</p>
{groups}
{units}
</section>"""
    return fill_page(
        title=f"Batch: {verdict}",
        kicker="Batch of reconstructions",
        name="",
        verdict=f"{verdict}. A unit is depth from all cameras of one instant of a session in one condition.",
        sections=[problems, words],
        footer="The same is in <code>summary.csv</code> and <code>summary.json</code> beside this page.",
    )


def _name(group: Group) -> str:
    return f"{escape(group.session)}<small>{escape(group.condition)}</small>"


def _unit(row: Row) -> str:
    name = escape(row.session)
    if row.folder:
        name = f'<a href="{escape(row.folder)}/{RESULT}">{name}</a>'
    at = [row.condition] if row.condition else []
    if row.problem and row.instant is not None:
        at.append(f"instant {row.instant}")
    return f"{name}<small>{escape(', '.join(at))}</small>" if at else name


def _instant(row: Row) -> str:
    return "" if row.instant is None else str(row.instant)


def _instants(group: Group) -> str:
    return f"{group.instants}" + (f"<small>{group.failed} failed</small>" if group.failed else "")


def _figures(row: Row | Group) -> list[str]:
    cells = [escape(wording.share(getattr(row, name))) for name in _SHARES]
    error = row.median_error_pct
    cells.append(wording.NOT_AVAILABLE if error is None else f"{error:.2f}{wording.GAP}%")
    cells.append(wording.number(row.fused_points))
    return cells
