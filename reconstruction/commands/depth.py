"""`reconstruct stereo` and `reconstruct multiview`."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from capture_app.common.text import count
from capture_app.console.terminal import Progress, answer, json_option, talk
from capture_app.console.usage import examples
from reconstruction.commands import command_options
from reconstruction.session.conditions import SYNCED, Condition

if TYPE_CHECKING:
    from reconstruction.multiview.result import SequenceResult


@click.command(epilog=examples("reconstruct stereo sessions/burst-001 --pair cam00,cam01 --out depth"))
@command_options.session_argument
@command_options.instant_option
@click.option(
    "--other-instant",
    type=click.IntRange(min=0),
    metavar="K",
    show_default="the same",
    help="Take the second camera's image from this instant.",
)
@command_options.pair_option("--pair", use="the depth map")
@command_options.time_shift_option
@command_options.out_option
@command_options.memory_option
@command_options.checksums_option
@json_option
def stereo(session: Path, out: Path, as_json: bool, **chosen: Any) -> None:
    """Compute a depth map from two cameras of SESSION, with its confidence and a picture."""
    from reconstruction.pairs import describe_left_out
    from reconstruction.stereo.stereo_run import StereoOptions
    from reconstruction.stereo.stereo_run import stereo as run

    result = run(session, out, StereoOptions(**chosen))
    for camera, why in result.left_out.items():
        talk(f"{camera} is left out: {why}")
    if result.pairs_left_out:
        talk(f"left out: {describe_left_out(result.pairs_left_out)}")
    lines = [
        f"{result.reference} and {result.other}: depth for {100 * result.coverage:.0f} % of the picture, "
        f"{result.nearest:.3g} to {result.farthest:.3g} {result.unit}"
    ]
    if result.within_2pct is not None:
        lines.append(f"within 2 % of the truth: {100 * result.within_2pct:.1f} %")
    answer(as_json, result, [*lines, f"depth: {out / result.depth}, picture: {out / result.picture}"])


def _parse_all_or_some(text: str) -> tuple[int, ...]:
    """Parse `all`, returned as None, or a list of instants."""
    return () if text.strip() == "all" else command_options.parse_instants(text)


@click.command(
    epilog=examples(
        "reconstruct multiview sessions/burst-001 --out cloud",
        "reconstruct multiview sessions/burst-001 --instant 3 --no-mesh --out cloud",
        "reconstruct multiview sessions/burst-001 --instants all --out clouds",
    )
)
@command_options.session_argument
@command_options.instant_option
@click.option(
    "--instants",
    type=_parse_all_or_some,
    metavar="all|K-L,M,...",
    help="Compute a cloud of each of these instants instead of one. A stopped run can be resumed.",
)
@click.option(
    "--condition",
    type=command_options.CONDITION,
    metavar="CONDITION",
    default=SYNCED,
    help=command_options.CONDITION_HELP,
)
@command_options.matcher_option
@click.option(
    "--mesh/--no-mesh",
    default=None,
    show_default="mesh; no mesh with --instants or --quick",
    help="Also compute a mesh and, for a single instant, a picture of it.",
)
@click.option("--quick", is_flag=True, help="Take half the time; thin parts and edges are less accurate.")
@click.option(
    "--page", is_flag=True, help="Also write a page with an interactive 3D view of one instant's cloud."
)
@click.option("--calibrated", is_flag=True, help="Refuse to run without a valid calibration of the rig.")
@click.option("--depth", is_flag=True, help="With --instants, also save the depth maps.")
@click.option("--whole", is_flag=True, help="With --instants, match the still scene again at every instant.")
@click.option("--rrd", is_flag=True, help="With --instants, also write a recording for Rerun.")
@command_options.time_shift_option
@command_options.out_option
@command_options.memory_option
@command_options.checksums_option
@json_option
@click.pass_context
def multiview(
    ctx: click.Context,
    /,
    session: Path,
    condition: Condition,
    out: Path,
    as_json: bool,
    instants: tuple[int, ...] | None,
    depth: bool,
    whole: bool,
    rrd: bool,
    **chosen: Any,
) -> None:
    """Compute depth maps of all cameras at one instant of SESSION, a point cloud and a mesh.

    With --instants, a point cloud of each of many instants, and masks of what moves.
    """
    from reconstruction.multiview.instant_model import MultiviewOptions
    from reconstruction.session.dataset import Dataset

    if instants is not None and chosen["page"]:
        raise click.UsageError("--page shows one instant: leave out --instants")
    if instants is None and (depth or whole or rrd):
        raise click.UsageError("--depth, --whole and --rrd need --instants")
    if instants is not None and ctx.get_parameter_source("instant") is not click.core.ParameterSource.DEFAULT:
        raise click.UsageError("give either --instant or --instants")
    if chosen["mesh"] is None:
        chosen["mesh"] = instants is None and not chosen["quick"]
    dataset = Dataset.open(session, chosen["time_shifts_ms"])
    condition.check(dataset)
    if instants is not None:
        from reconstruction.multiview.sequence import SequenceOptions, model_sequence

        sequence_options = SequenceOptions(
            instants=instants or None,
            condition=condition,
            each=MultiviewOptions(**chosen),
            depth=depth,
            whole=whole,
            recording=rrd,
        )
        _show_sequence(model_sequence(session, out, sequence_options, Progress(1)), out, as_json)
        return
    from reconstruction.multiview.instant_model import multiview as run

    offsets_ms = condition.offsets_ms(dataset.cameras, chosen["instant"])
    result = run(session, out, MultiviewOptions(offsets_ms=offsets_ms, **chosen), Progress(1))
    for camera, why in result.left_out.items():
        talk(f"{camera} is left out: {why}")
    measured = result.moving_measured
    moving = "" if measured is None else f"; {100 * measured:.0f} % of moving pixels have depth"
    maps = f"{count(len(result.views), 'depth map')}, {result.fused_points:,} points"
    lines = [f"{maps} in {result.seconds:.1f} s{moving}"]
    if (right := result.within_2pct) is not None:
        lines.append(f"{result.reference}: {100 * right:.1f} % of its pixels within 2 % of the true depth")
    answer(as_json, result, [*lines, f"result: {out}"])


def _show_sequence(result: "SequenceResult", out: Path, as_json: bool) -> None:
    for one in result.instants:
        if one.reason:
            talk(f"instant {one.instant} has no cloud: {one.reason}")
    reused = f", {result.kept} of them reused" if result.kept else ""
    lines = [f"{count(result.clouds, 'cloud')}{reused} in {result.seconds:.1f} s"]
    if result.mover_f_score_1cm is not None:
        lines.append(
            f"moving objects: F-score {result.mover_f_score_1cm:.2f} at 1 cm, median of the instants"
        )
    answer(as_json, result, [*lines, f"result: {out}"])
