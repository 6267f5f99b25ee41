"""All measurements of the paper as a Markdown page and as JSON, with pictures."""

import re
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.paper.applications import Application, compare_samples, read_compared
from benchmarks.paper.report import Entry, PaperReport, Row, SetUp, make_report, measure_all
from capture_app.common.errors import BadInputError
from capture_app.common.text import count, pretty_json
from capture_app.session.files.durable import write_atomic

TITLE = "The paper's tables and figures, and ours"
LEAD = (
    "Ansari, Wadhwa, Garg and Chen, Wireless Software Synchronization of Multiple Distributed Cameras (ICCP "
    "2019), measured with real phones. All our numbers on this page are simulated: the engine is the "
    "program's own, but its cameras, clocks, links and LED panels are models."
)
KEY = (
    "Two columns are ours. ✓, ✗: with the paper's protocol, our value is at most the paper's, or larger. "
    "=: the paper's number is an input of the model: agreement shows nothing."
)
HEAD = ("", "paper", "its protocol", "default")
APPLICATIONS_LEAD = (
    "Other commands make these from the bundled, simulated sessions. The paper shows pictures without "
    "numbers."
)
CONDITIONS = {"synced": "synchronized", "offset": "some time apart"}
NOTHING = "–"
UNITS = {"us": "µs", "degrees": "°"}
SIGNS = {"better": "✓", "worse": "✗", "put in": "=", "": ""}


def number(value: float | None, unit: str, *, digits: int | None = None) -> str:
    """Format a number with its unit, to three significant digits or this many decimals."""
    if value is None:
        return NOTHING
    if digits is None and unit == "ms" and 0 < abs(value) < 0.1:
        digits = 4
    if digits is None:
        digits = 0 if abs(value) >= 100 or value == round(value) else 1 if abs(value) >= 10 else 2
    text = f"{value:,.{digits}f}"
    return f"{text}\N{NO-BREAK SPACE}{UNITS.get(unit, unit)}" if unit else text


def cells(row: Row) -> tuple[str, str, str]:
    """Format the paper's number, ours at its protocol with a comparison, and ours by default."""
    ours = f"{number(row.protocol, row.unit)} {SIGNS[row.verdict]}".strip()
    return _papers(row), ours, number(row.default, row.unit)


def _papers(row: Row) -> str:
    """Format the paper's number as the paper does."""
    if row.paper is None:
        return NOTHING
    text = number(row.paper, row.unit, digits=len(f"{row.paper:.6g}".partition(".")[2]))
    return f"≤\N{NO-BREAK SPACE}{text}" if row.paper_at_most else text


def set_ups(entry: Entry) -> tuple[str, ...]:
    """Return how both of our numbers were measured."""
    if entry.default == entry.protocol:  # the set-ups, not the numbers
        return (f"Both: {_set_up(entry.protocol)}",)
    return (
        f"Its protocol: {_set_up(entry.protocol)}",
        f"Default: {_set_up(entry.default)}",
    )


def _set_up(one: SetUp) -> str:
    return f"{in_print(one.setup)} ({count(one.trials, 'trial')})."


def in_print(text: str) -> str:
    """Return a text with typographic units."""
    return re.sub(r"(?<=\d) us\b", "\N{NO-BREAK SPACE}µs", text)


def measured(report: PaperReport) -> str:
    """Return how the report was produced."""
    quick = " --quick" if report.quick else ""
    return (
        f"Made by `python -m benchmarks.paper paper{quick}`, seed {report.seed}; "
        "each entry states its trials."
    )


def headlines(report: PaperReport) -> list[tuple[Entry, Row]]:
    """Return the numbers for the top of the page, each with its entry."""
    entries = (*report.tables, *report.figures)
    return [(entry, row) for entry in entries for row in entry.rows if row.headline]


def render_markdown(report: PaperReport, pictures: str) -> str:
    """Return the page; `pictures` is the prefix of the pictures' names in links."""
    return "\n".join([*_lines(report, pictures), ""])


def _lines(report: PaperReport, pictures: str) -> Iterator[str]:
    yield f"# {TITLE}"
    yield ""
    yield f"{LEAD} {measured(report)}"
    yield ""
    yield from _table(
        (row, f"[{entry.place}](#{_anchor(entry)}): {row.label}") for entry, row in headlines(report)
    )
    yield ""
    yield KEY
    for title, entries in (("Tables", report.tables), ("Figures", report.figures)):
        yield ""
        yield f"## {title}"
        for entry in entries:
            yield from _entry_lines(entry, pictures)
    yield ""
    yield "## Applications"
    yield ""
    yield APPLICATIONS_LEAD
    for one in report.applications:
        yield from _application(one, pictures)


def _application(one: Application, pictures: str) -> Iterator[str]:
    yield ""
    yield f"### {one.place}: {one.title}"
    names = list(CONDITIONS.values())
    if len(one.files) == len(names):
        yield from ("", f"| {' | '.join(names)} |", "|---|---|")
        shown = (
            f"![{condition}]({pictures}{name})" for condition, name in zip(names, one.files, strict=True)
        )
        yield f"| {' | '.join(shown)} |"
    else:
        for name in one.files:
            yield ""
            yield f"![{one.place}]({pictures}{name})"
    if one.engine:
        yield ""
        yield one.engine
    if one.measures:
        yield ""
        yield f"|  | {' | '.join(names)} |"
        yield "|---|---:|---:|"
        for measure in one.measures:
            written = (number(getattr(measure, name), measure.unit) for name in CONDITIONS)
            yield f"| {measure.label} | {' | '.join(written)} |"
    yield ""
    yield f"`{one.command}`" + ("" if one.measures else " (not run for this page)")


def _anchor(entry: Entry) -> str:
    """Return the anchor that Markdown viewers give a heading."""
    kept = (char for char in _heading(entry).lower() if char.isalnum() or char in " -")
    return "".join(kept).replace(" ", "-")


def _heading(entry: Entry) -> str:
    return f"{entry.place}: {entry.title}"


def _entry_lines(entry: Entry, pictures: str) -> Iterator[str]:
    yield ""
    yield f"### {_heading(entry)}"
    for name in entry.files:
        yield ""
        yield f"![{entry.place}]({pictures}{name})"
    yield ""
    yield from _table((row, row.label) for row in entry.rows)
    yield ""
    simulated = f"Simulated: {in_print(entry.simulated)}"
    yield " ".join((simulated, *set_ups(entry)))
    for note in entry.notes:
        yield ""
        yield in_print(note)


def _table(rows: "Iterator[tuple[Row, str]]") -> Iterator[str]:
    yield f"| {' | '.join(HEAD)} |"
    yield "|---|---:|---:|---:|"
    for row, label in rows:
        yield f"| {label} | {' | '.join(cells(row))} |"


QUICK_SHARE = 0.25
PAGE, NUMBERS = "paper.md", "paper.json"


def run(
    out: Path,
    *,
    quick: bool,
    seed: int,
    compared: Sequence[Path] = (),
    markdown: Path | None = None,
    only: frozenset[str] = frozenset(),
) -> PaperReport:
    """Measure everything and write the page into an existing folder; `only` names keys, empty for all.

    `compared` are folders of `reconstruct compare` for bundled sessions; without any, and without `only`,
    they are made here. `markdown` is a file that also gets the page; its pictures go into `images` beside it.
    Raises BadInputError if something cannot be read or written, NotAvailableError without matplotlib.
    """
    if not compared and not only:
        compared = compare_samples(out / "compared", quick=quick)
    applications = read_compared(compared, out)
    found = measure_all(share=QUICK_SHARE if quick else 1.0, seed=seed, only=only)
    try:
        report = make_report(found, applications, out, quick=quick, seed=seed)
        write_atomic(out / NUMBERS, pretty_json(report))
        write_atomic(out / PAGE, render_markdown(report, "").encode())
        if markdown is not None:
            _write_markdown(report, out, markdown)
    except OSError as error:
        where = error.filename or out
        raise BadInputError(
            f"cannot write {where}: {error.strerror}", hint="choose another folder with --out"
        ) from error
    return report


def _write_markdown(report: PaperReport, out: Path, markdown: Path) -> None:
    before = f"images/{markdown.stem}-"
    (markdown.parent / "images").mkdir(parents=True, exist_ok=True)
    for name in report.pictures():
        shutil.copyfile(out / name, markdown.parent / f"{before}{name}")
    write_atomic(markdown, render_markdown(report, before).encode())
