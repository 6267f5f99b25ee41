"""`reconstruct stereo`."""

from pathlib import Path
from typing import Any

import click

from capture_app.terminal import json_option, print_json, print_line, talk
from capture_app.usage import examples
from reconstruction.commands.options import (
    checksums_option,
    instant_option,
    memory_option,
    out_option,
    pair_option,
    session_argument,
    time_shift_option,
)


@click.command(epilog=examples("reconstruct stereo sessions/burst-001 --pair cam00,cam01 --out depth"))
@session_argument
@instant_option
@click.option(
    "--other-instant",
    type=click.IntRange(min=0),
    metavar="K",
    show_default="the same",
    help="Take the second camera's image from this instant.",
)
@pair_option("--pair", use="the depth map")
@time_shift_option
@out_option
@memory_option
@checksums_option
@json_option
def stereo(session: Path, out: Path, as_json: bool, **options: Any) -> None:
    """Compute a depth map from two cameras of SESSION, with its confidence and a picture."""
    from reconstruction.pairs.pair_choice import describe_left_out
    from reconstruction.stereo.command import StereoOptions
    from reconstruction.stereo.command import stereo as run

    result = run(session, out, StereoOptions(**options))
    for camera, why in result.left_out.items():
        talk(f"{camera} is left out: {why}")
    if result.pairs_left_out:
        talk(f"left out: {describe_left_out(result.pairs_left_out)}")
    if as_json:
        print_json(result)
        return
    print_line(
        f"{result.reference} and {result.other}: depth for {100 * result.coverage:.0f} % of the picture, "
        f"{result.nearest:.3g} to {result.farthest:.3g} {result.unit}"
    )
    if result.within_2pct is not None:
        print_line(f"within 2 % of the truth: {100 * result.within_2pct:.1f} %")
    print_line(f"depth: {out / result.depth}, picture: {out / result.picture}")
