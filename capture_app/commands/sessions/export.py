"""`capture-app sessions export`: a session in the format of another program."""

from pathlib import Path
from typing import Any

import click

from capture_app.commands.options import ANY_PATH
from capture_app.session.exporters.formats import FORMATS
from capture_app.session.reading.reader import Session
from capture_app.terminal import FiniteRange, json_option, print_json, print_line, show_count, talk
from capture_app.usage import examples

_FORMATS = "\b\n" + "\n".join(f"{name:<11} {what}" for name, what in FORMATS.items())


@click.command(
    "export",
    epilog=examples("capture-app sessions export sessions/burst-001 --to mp4 --out videos", after=_FORMATS),
)
@click.argument("session", type=ANY_PATH)
@click.option("--to", "name", type=click.Choice(list(FORMATS)), required=True, help="Format: see below.")
@click.option("--out", type=ANY_PATH, metavar="DIR", required=True, help="New or empty folder to write.")
@click.option(
    "--hard-link", is_flag=True, help="Hard-link image files where possible instead of copying them."
)
@click.option("--lossless", is_flag=True, help="Videos and redrawn pictures without loss: far larger.")
@click.option(
    "--instant",
    type=click.IntRange(min=0),
    metavar="N",
    help="For colmap, nerfstudio, easyvolcap: one instant only, counted from 0.",
)
@click.option(
    "--points",
    type=ANY_PATH,
    metavar="PLY",
    help="For colmap, nerfstudio, n3dv: points to start from, as reconstruct multiview makes.",
)
@click.option(
    "--masks",
    type=ANY_PATH,
    metavar="DIR",
    help="For colmap, nerfstudio, easyvolcap: masks of what moves, as reconstruct movers makes.",
)
@click.option(
    "--whole",
    is_flag=True,
    help="For n3dv: whole pictures with black around them, not cut to what fills all films.",
)
@click.option(
    "--near",
    type=FiniteRange(min=0, min_open=True),
    metavar="DEPTH",
    help="For n3dv: smallest depth, in the calibration's unit.",
)
@click.option(
    "--far", type=FiniteRange(min=0, min_open=True), metavar="DEPTH", help="For n3dv: largest depth."
)
@json_option
def export(session: Path, name: str, out: Path, hard_link: bool, as_json: bool, **chosen: Any) -> None:
    """Convert SESSION to the format of another program.

    docs/exports.md describes how each format stores the times and what happens to missing images.
    """
    from capture_app.session.exporters.common.exported_burst import ExportOptions
    from capture_app.session.exporters.export_session import export_session

    options = ExportOptions(link=hard_link, **chosen)
    report = export_session(Session.open(session), name, out, options, show_count("images"))
    if as_json:
        print_json(report)
    else:
        print_line(report.folder)
    for note in report.notes:
        talk(note)
