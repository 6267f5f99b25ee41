"""`reconstruct time`."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from capture_app.console.terminal import answer, json_option
from capture_app.console.usage import examples
from reconstruction.commands.options import checksums_option, memory_option, session_argument

if TYPE_CHECKING:
    from reconstruction.time_offsets.session_offsets import TimeResult


@click.command(
    "time",
    epilog=examples("reconstruct time sessions/burst-001", "reconstruct time sessions/videos --apply"),
)
@session_argument
@click.option(
    "--reference",
    metavar="CAMERA",
    show_default="chosen automatically",
    help="The camera that the others are measured against.",
)
@click.option(
    "--apply",
    is_flag=True,
    help="Give a recording without common times those that were measured; its images are paired anew.",
)
@memory_option
@checksums_option
@json_option
def time_command(session: Path, reference: str | None, apply: bool, as_json: bool) -> None:
    """Measure how late each camera of SESSION is, by a lamp that blinks, or by what moves in its pictures.

    An offset is what --time-shift-ms adds to the camera's times to mend it. Of a recording without common
    times it is looked for however large it is, with the rate. A torch that blinks eight times before all
    cameras also tells how long their rows take.
    """
    from reconstruction.time_offsets.session_offsets import measure_times

    result = measure_times(session, reference, apply=apply)
    aligned = f"{session}: aligned by what moves" if result.applied else ""
    answer(as_json, result, filter(None, (*_lines(result), aligned)))


def _lines(result: "TimeResult") -> Iterator[str]:
    for name, found in result.cameras.items():
        if found.offset_ms is None or found.sd_ms is None:
            yield f"{name}: cannot be told: {found.reason}"
        elif name == result.reference:
            yield f"{name}: the reference"
        else:
            more = ""
            if found.rate_ppm is not None and found.rate_sd_ppm is not None:
                more = f", rate {found.rate_ppm:+.1f} ± {2 * found.rate_sd_ppm:.1f} ppm"
            if found.row_time_ns is not None and found.row_time_sd_ns is not None:
                more = f", rows {found.row_time_ns / 1e3:.2f} ± {2 * found.row_time_sd_ns / 1e3:.2f} us"
            yield f"{name}: {found.offset_ms:+.2f} ± {2 * found.sd_ms:.2f} ms{more} (95 %)"
