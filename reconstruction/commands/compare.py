"""`reconstruct compare`."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from capture_app.terminal import json_option, print_json, print_line
from reconstruction.commands.arguments import Finite, Offsets, Pair

if TYPE_CHECKING:
    from reconstruction.session.conditions import Condition


@click.command()
@click.argument("session", type=click.Path(path_type=Path))
@click.option(
    "--offset-ms",
    type=Finite(min=0, min_open=True, max=1e6),
    default=66.0,
    show_default=True,
    help="How late the second camera is in the offset condition, ms; the nearest whole frame is taken.",
)
@click.option("--stereo", type=Pair(), help="The two cameras for depth [default: chosen by what they see].")
@click.option("--stitch", type=Pair(), help="The two cameras for the panorama [default: likewise].")
@click.option(
    "--instants",
    type=click.IntRange(min=1),
    default=16,
    show_default=True,
    help="Use at most so many instants, spread over the burst.",
)
@click.option(
    "--multiview-instants",
    type=click.IntRange(min=0),
    default=3,
    show_default=True,
    help="Of these, at most so many for depth from all cameras, which takes much longer; 0: none.",
)
@click.option(
    "--multiview-width",
    type=click.IntRange(min=160),
    default=640,
    show_default=True,
    help="Make pictures wider than this smaller for that, px.",
)
@click.option(
    "--poses/--no-poses",
    default=None,
    help="Find where the cameras stand from single instants [default: where much of the picture moves].",
)
@click.option(
    "--offsets-ms",
    type=Offsets(),
    multiple=True,
    help="A further condition: how late each camera is, ms; may be given several times.",
)
@click.option(
    "--drawn",
    is_flag=True,
    help="A further condition: every camera off by one of -66, -33, 0, 33, 66 ms, drawn for each instant.",
)
@click.option(
    "--against",
    type=click.Path(path_type=Path),
    help="A further condition: another session of the same cameras, such as one without synchronization.",
)
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for the result.")
@json_option
def compare(
    session: Path,
    offset_ms: float,
    stereo: tuple[str, str] | None,
    stitch: tuple[str, str] | None,
    instants: int,
    multiview_instants: int,
    multiview_width: int,
    poses: bool | None,
    offsets_ms: "tuple[Condition, ...]",
    drawn: bool,
    against: Path | None,
    out: Path,
    as_json: bool,
) -> None:
    """Compare SESSION's images of the same instant with images taken some time apart.

    Writes metrics.json, pictures and a report.html that explains itself into the --out folder.
    """

    from reconstruction.compare.all_cameras import AllCamerasOptions
    from reconstruction.compare.command import CompareOptions
    from reconstruction.compare.command import compare as run
    from reconstruction.session.conditions import DISTINCT, Condition

    options = CompareOptions(
        offset_ms=offset_ms,
        stereo=stereo,
        stitch=stitch,
        most_instants=instants,
        all_cameras=AllCamerasOptions(
            multiview_instants=multiview_instants, multiview_width=multiview_width, poses=poses
        ),
        conditions=(*offsets_ms, *((Condition(DISTINCT),) if drawn else ())),
        against=against,
    )
    result = run(session, out, options)
    if as_json:
        print_json(result)
        return
    print_line(result.verdict)
    print_line(f"report: {out / result.report}")
