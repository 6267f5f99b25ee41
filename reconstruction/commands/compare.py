"""`reconstruct compare`."""

from pathlib import Path
from typing import Any

import click

from capture_app.console.terminal import FiniteRange, answer, json_option
from capture_app.console.usage import examples
from reconstruction.commands import options
from reconstruction.session.conditions import DEFAULT_OFFSET_MS, MAX_OFFSET_MS, SYNCED, Condition


def _refuse_synced(
    ctx: click.Context, param: click.Parameter, value: tuple[Condition, ...]
) -> tuple[Condition, ...]:
    if any(condition.name == SYNCED for condition in value):
        raise click.BadParameter(f"{SYNCED} is part of every comparison; name another condition")
    return value


@click.command(epilog=examples("reconstruct compare sessions/burst-001 --offset-ms 66 --out compare"))
@options.session_argument
@click.option(
    "--offset-ms",
    type=FiniteRange(min=0, min_open=True, max=MAX_OFFSET_MS),
    metavar="MS",
    default=DEFAULT_OFFSET_MS,
    help="How late the second camera of a pair is, rounded to whole frames.",
)
@options.pair_option("--stereo-pair", "stereo", use="depth")
@options.pair_option("--panorama-pair", "panorama", use="the panorama")
@options.pair_option("--stitch-pair", "panorama", use="the panorama", hidden=True)
@options.max_instants_option
@options.time_shift_option
@click.option(
    "--max-multiview-instants",
    "multiview_instants",
    type=click.IntRange(min=0),
    metavar="N",
    default=3,
    help="Use at most this many of them for depth from all cameras, which takes much longer; 0 for none.",
)
@click.option(
    "--multiview-width",
    type=click.IntRange(min=160),
    metavar="PX",
    default=640,
    help="Reduce wider images to this width for depth from all cameras.",
)
@options.matcher_option
@click.option(
    "--poses/--no-poses",
    default=None,
    show_default="if much of the picture moves",
    help="Also estimate the camera poses from single instants.",
)
@click.option(
    "--condition",
    "conditions",
    type=options.CONDITION,
    metavar="CONDITION",
    multiple=True,
    callback=_refuse_synced,
    help=f"Compare with this condition too. Repeat for several. {options.OFFSETS_HELP}",
)
@click.option(
    "--against",
    type=click.Path(path_type=Path),
    metavar="SESSION",
    help="Compare with another session of the same cameras too, such as one without synchronization.",
)
@options.out_option
@options.memory_option
@options.checksums_option
@json_option
def compare(session: Path, out: Path, as_json: bool, **chosen: Any) -> None:
    """Compare synchronized images of SESSION with images that are some time apart.

    Writes metrics.json, pictures and a self-explanatory report.html to the --out folder.
    """
    from reconstruction.compare.comparison import CompareOptions
    from reconstruction.compare.comparison import compare as run

    result = run(session, out, CompareOptions(**chosen))
    answer(as_json, result, [result.verdict, f"report: {out / result.report}"])
