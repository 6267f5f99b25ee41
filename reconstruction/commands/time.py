"""`reconstruct time`."""

from pathlib import Path

import click

from capture_app.terminal import json_option, print_json, print_line
from capture_app.usage import examples
from reconstruction.commands.options import checksums_option, memory_option, session_argument


@click.command(
    "time",
    epilog=examples("reconstruct time sessions/burst-001"),
)
@session_argument
@click.option(
    "--reference",
    metavar="CAMERA",
    show_default="chosen automatically",
    help="The camera that the others are measured against.",
)
@memory_option
@checksums_option
@json_option
def time_command(session: Path, reference: str | None, as_json: bool) -> None:
    """Measure how late each camera of SESSION is, by what moves in its pictures.

    An offset is what --time-shift-ms adds to the camera's times to mend it.
    """
    from reconstruction.time_offsets.command import measure_times

    result = measure_times(session, reference)
    if as_json:
        print_json(result)
        return
    for name, found in result.cameras.items():
        if found.offset_ms is None or found.sd_ms is None:
            print_line(f"{name}: cannot be told: {found.reason}")
        elif name == result.reference:
            print_line(f"{name}: the reference")
        else:
            print_line(f"{name}: {found.offset_ms:+.2f} ± {2 * found.sd_ms:.2f} ms (95 %)")
