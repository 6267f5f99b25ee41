"""A batch's summary as a page for people, in the look of the reports."""

from html import escape
from importlib.resources import files

from reconstruction import wording
from reconstruction.batch_rows import BatchResult, Group, Row
from reconstruction.report_cells import Head, listing
from reconstruction.unit_plan import RESULT

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
    css = (files("reconstruction") / "report_page" / "page.css").read_text("utf-8")
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>Batch: {verdict}</title>
<link rel="icon" href="data:,">
<style>
{css}</style>
</head>
<body>
<header>
<p class="kicker">Batch of reconstructions</p>
<h1>{verdict}</h1>
<p class="lead">A unit is one instant of a session in one condition: depth from all its cameras.</p>
</header>
<main>
{problems}
<section>
<p>The figures are those of each instant's reference camera. Measured correctly: within 2{wording.GAP}% of
the true distance, where that is known; what was given none counts as wrong.</p>
{groups}
{units}
</section>
</main>
<footer><p>Made by simulshot. The same is in <code>summary.csv</code> and <code>summary.json</code> beside
this page.</p></footer>
</body>
</html>
"""


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
