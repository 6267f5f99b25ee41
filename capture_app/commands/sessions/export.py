"""`capture-app sessions export`: a session in the form that another program opens."""

import sys
from pathlib import Path

import click
import msgspec

from capture_app.session.exporters.formats import FORMATS
from capture_app.session.reading.reader import Session

_FOLDER = click.Path(path_type=Path)


# A line that is only \b keeps click from wrapping the paragraph.
_FORMATS_TEXT = "\b\n" + "\n".join(f"{name:<11} {what}" for name, what in FORMATS.items())


@click.command("export", epilog=_FORMATS_TEXT)
@click.argument("session", type=_FOLDER)
@click.option(
    "--to",
    "name",
    type=click.Choice(list(FORMATS)),
    required=True,
    help="What to make: one of the formats below.",
)
@click.option("--out", type=_FOLDER, required=True, help="The folder to make; an empty one may exist.")
@click.option("--link", is_flag=True, help="Hard-link image files instead of copying them, where they stay.")
@click.option(
    "--near",
    type=click.FloatRange(min=0, min_open=True),
    help="n3dv: least depth, in the calibration's unit.",
)
@click.option("--far", type=click.FloatRange(min=0, min_open=True), help="n3dv: greatest depth.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def export(
    session: Path, name: str, out: Path, link: bool, near: float | None, far: float | None, as_json: bool
) -> None:
    """Write SESSION in the form of another program.

    docs/exports.md tells what each form keeps of the times, and what becomes of missing images.
    """
    from capture_app.session.exporters.common.burst import ExportOptions
    from capture_app.session.exporters.registry import export_session

    options = ExportOptions(link=link, near=near, far=far)
    try:
        report = export_session(Session.open(session), name, out, options, _progress)
    finally:
        if sys.stderr.isatty():
            click.echo("\r\033[K", nl=False, err=True)
    if as_json:
        click.echo(msgspec.json.format(msgspec.json.encode(report), indent=2))
    else:
        click.echo(report.folder)
    for note in report.notes:
        click.echo(note, err=True)


def _progress(done: int, total: int) -> None:
    if sys.stderr.isatty():
        click.echo(f"\r{done} of {total} images", nl=False, err=True)
