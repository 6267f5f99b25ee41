"""`capture-app experiment paper`: all tables and figures of the paper on one page."""

from pathlib import Path

import click

from capture_app.commands.experiment.options import require_plots, seed_option
from capture_app.commands.options import FOLDER
from capture_app.experiments.common.paper_values import FIGURES, TABLES
from capture_app.terminal import json_option, print_json, print_line, print_table, talk
from capture_app.usage import examples


@click.command(
    name="paper",
    epilog=examples(
        "capture-app experiment paper --quick --out paper",
        "capture-app experiment paper --only table-2 --out paper",
    ),
)
@click.option(
    "--out",
    type=FOLDER,
    metavar="DIR",
    required=True,
    callback=require_plots,
    help="Folder for index.html, paper.json and the pictures (needs matplotlib).",
)
@click.option("--quick", is_flag=True, help="A quarter of the trials: at most four minutes on two cores.")
@click.option(
    "--only",
    metavar="KEY",
    multiple=True,
    type=click.Choice([one.key for one in (*TABLES, *FIGURES)]),
    help="Measure this table or figure only, such as table-2. Repeat for several.",
)
@click.option(
    "--compared",
    type=FOLDER,
    metavar="DIR",
    multiple=True,
    help="Folder that `reconstruct compare` has written, of a session in sample_sessions/, to show as the "
    "paper's applications. Repeat for several.",
)
@click.option(
    "--markdown",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Also write the page as Markdown, its pictures into images/ beside it.",
)
@seed_option
@json_option
def paper(
    out: Path,
    quick: bool,
    only: tuple[str, ...],
    compared: tuple[Path, ...],
    markdown: Path | None,
    seed: int,
    as_json: bool,
) -> None:
    """Measure every table and figure of the paper, as it did and by default, and write a page."""
    from capture_app.experiments.paper import experiment as study
    from capture_app.experiments.paper.wording import HEAD, by_default, headlines, ours, papers, sign

    report = study.run(
        out,
        quick=quick,
        seed=seed,
        talk=talk,
        compared=compared,
        markdown=markdown,
        only=frozenset(only),
    )
    if as_json:
        print_json(report)
        return
    rows = [
        (f"{entry.place}: {row.label}", papers(row), ours(row), sign(row), by_default(row))
        for entry, row in headlines(report)
    ]
    print_table((*HEAD[:3], "", HEAD[3]), rows)
    print_line(f"\n{out / study.PAGE}")
