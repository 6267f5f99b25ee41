"""`reconstruct time`."""

from pathlib import Path

import click

from capture_app.console.terminal import answer, json_option
from capture_app.console.usage import examples
from reconstruction.commands.command_options import session_argument


@click.command(
    "time",
    epilog=examples(
        "reconstruct time sessions/burst-001",
        "reconstruct time sessions/videos --apply",
        "reconstruct time sessions/videos --repair-drops",
    ),
)
@session_argument
@click.option(
    "--reference",
    metavar="CAMERA",
    show_default="chosen automatically",
    help="Camera against which the others are measured.",
)
@click.option(
    "--apply",
    is_flag=True,
    help="Set the measured times of a recording without common times, and pair its images again.",
)
@click.option(
    "--repair-drops",
    is_flag=True,
    help="Pair the images of an imported session again where a camera dropped or repeated frames.",
)
@json_option
def time_command(
    session: Path, reference: str | None, apply: bool, repair_drops: bool, as_json: bool
) -> None:
    """Measure the time offset of each camera of SESSION, by a blinking lamp or by motion in its pictures.

    Pass an offset to --time-shift-ms of other commands to correct it. In a recording without common times,
    offsets of any size and clock rates are measured. A torch that blinks eight times in front of all cameras
    also gives the time between their rows.
    """
    from reconstruction.common.templates import render_lines
    from reconstruction.method.spoken import spoken
    from reconstruction.time_offsets.session_offsets import measure_times

    result = measure_times(session, reference, apply=apply, repair_drops=repair_drops)
    answer(
        as_json,
        result,
        render_lines("times.txt", "reconstruction.commands", result=spoken(result, result.labels)),
    )
