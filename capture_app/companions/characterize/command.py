"""`capture-app cameras characterize`: what one camera is capable of, measured."""

import asyncio
from typing import TYPE_CHECKING

import click

from capture_app.common.templates import render_rows
from capture_app.console.terminal import FiniteRange, answer, json_option, table, talk
from capture_app.console.usage import examples

if TYPE_CHECKING:
    from capture_app.companions.characterize.camera_character import Character


@click.command(
    epilog=examples(
        "capture-app cameras characterize v4l2:/dev/video0",
        "capture-app cameras characterize sim:phone-a --seconds 3 --starts 2 --json",
    )
)
@click.argument("spec")
@click.option("--seconds", type=FiniteRange(1.0, 3600.0), default=10.0, metavar="S", help="Observation time.")
@click.option(
    "--starts",
    type=click.IntRange(0, 100),
    default=8,
    metavar="N",
    help="Number of stream restarts. A camera that nodes cannot restart is closed and opened.",
)
@click.option(
    "--save/--no-save", default=True, help="Save the results in this user's profiles, for nodes to use."
)
@json_option
def characterize(spec: str, seconds: float, starts: int, save: bool, as_json: bool) -> None:
    """Measure the camera SPEC in about a minute; no node may use it meanwhile.

    Reports the camera's modes, the resolution and jitter of its timestamps, and its start latency. If frames
    can be made longer, also the effect on its phase: row time, injection gain and overhead. Nodes use the
    restart and injection results from their first command on. For the timestamp delay, use `cameras
    calibrate-time`.
    """
    from capture_app.companions.characterize.camera_character import characterize as measure

    character = asyncio.run(measure(spec, seconds=seconds, starts=starts, keep=save, talk=talk))
    saved = ["saved in this user's profiles; nodes use them from now on"]
    answer(as_json, character, [table((spec, ""), _rows(character)), *saved[: character.saved]])


def _rows(character: "Character") -> list[tuple[str, ...]]:
    from capture_app.common.camera_facts import describe_stamp

    stamps = describe_stamp(character.camera.stamp_accuracy)
    return render_rows("character.txt", __package__, found=character, stamps=stamps)
