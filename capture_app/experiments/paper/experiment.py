"""All that is measured of the paper, written as a page, as JSON and as Markdown."""

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from capture_app.errors import BadInputError
from capture_app.experiments.paper.compared import read_compared
from capture_app.experiments.paper.markdown import render_markdown
from capture_app.experiments.paper.page import render_page
from capture_app.experiments.paper.parts import measure_all
from capture_app.experiments.paper.report import PaperReport, make_report
from capture_app.session.files.durable import write_atomic
from capture_app.text import pretty_json

QUICK_SHARE = 0.25
PAGE, NUMBERS = "index.html", "paper.json"


def run(
    out: Path,
    *,
    quick: bool,
    seed: int,
    talk: Callable[[str], None],
    compared: Sequence[Path] = (),
    markdown: Path | None = None,
    only: frozenset[str] = frozenset(),
) -> PaperReport:
    """Measure everything and write the page into a folder that exists; `only` names keys, empty for all.

    `compared` are folders of `reconstruct compare`, of bundled sessions. `markdown` is a file that gets the
    page, too; its pictures go into `images` beside it. Raises BadInputError where something cannot be read
    or written, NotAvailableError without matplotlib.
    """
    applications = read_compared(compared, out)
    found = measure_all(share=QUICK_SHARE if quick else 1.0, seed=seed, talk=talk, only=only)
    try:
        report = make_report(found, applications, out, quick=quick, seed=seed, talk=talk)
        write_atomic(out / NUMBERS, pretty_json(report))
        write_atomic(out / PAGE, render_page(report).encode())
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
