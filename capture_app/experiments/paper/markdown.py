"""The page as Markdown, for the documentation."""

from collections.abc import Iterator

from capture_app.experiments.paper import wording
from capture_app.experiments.paper.applications import Application
from capture_app.experiments.paper.report import Entry, PaperReport, Row


def render_markdown(report: PaperReport, pictures: str) -> str:
    """Return the page; `pictures` comes before its pictures' names in links to them."""
    return "\n".join([*_lines(report, pictures), ""])


def _lines(report: PaperReport, pictures: str) -> Iterator[str]:
    yield f"# {wording.TITLE}"
    yield ""
    yield f"{wording.LEAD} {wording.measured(report)}"
    yield ""
    yield from _table(
        (row, f"[{entry.place}](#{_anchor(entry)}): {row.label}") for entry, row in wording.headlines(report)
    )
    yield ""
    yield wording.KEY
    for title, entries in (("Tables", report.tables), ("Figures", report.figures)):
        yield ""
        yield f"## {title}"
        for entry in entries:
            yield from _entry(entry, pictures)
    yield ""
    yield "## Applications"
    yield ""
    yield wording.APPLICATIONS_LEAD
    for one in report.applications:
        yield from _application(one, pictures)


def _application(one: Application, pictures: str) -> Iterator[str]:
    yield ""
    yield f"### {one.place}: {one.title}"
    names = list(wording.CONDITIONS.values())
    if len(one.files) == len(names):
        yield ""
        yield f"| {' | '.join(names)} |"
        yield "|---|---|"
        yield f"| {' | '.join(f'![{one.title}]({pictures}{name})' for name in one.files)} |"
    else:
        for name in one.files:
            yield ""
            yield f"![{one.title}]({pictures}{name})"
    if one.measures:
        yield ""
        yield f"|  | {' | '.join(names)} |"
        yield "|---|---:|---:|"
        for measure in one.measures:
            cells = (wording.condition(measure, name) for name in wording.CONDITIONS)
            yield f"| {measure.label} | {' | '.join(cells)} |"
    yield ""
    yield f"`{one.command}`" + ("" if one.measures else " (not run for this page)")


def _anchor(entry: Entry) -> str:
    """The anchor that a heading gets where Markdown is shown."""
    kept = (char for char in _heading(entry).lower() if char.isalnum() or char in " -")
    return "".join(kept).replace(" ", "-")


def _heading(entry: Entry) -> str:
    return f"{entry.place}: {entry.title}"


def _entry(entry: Entry, pictures: str) -> Iterator[str]:
    yield ""
    yield f"### {_heading(entry)}"
    for name in entry.files:
        yield ""
        yield f"![{entry.title}]({pictures}{name})"
    yield ""
    yield from _table((row, row.label) for row in entry.rows)
    yield ""
    simulated = f"Simulated: {wording.in_print(entry.simulated)}"
    yield " ".join((simulated, *wording.set_ups(entry), f"Seed {entry.seed}."))
    for note in entry.notes:
        yield ""
        yield wording.in_print(note)


def _table(rows: "Iterator[tuple[Row, str]]") -> Iterator[str]:
    yield f"| {' | '.join(wording.HEAD)} |"
    yield "|---|---:|---:|---:|"
    for row, label in rows:
        ours = f"{wording.ours(row)} {wording.sign(row)}".strip()
        yield f"| {label} | {wording.papers(row)} | {ours} | {wording.by_default(row)} |"
