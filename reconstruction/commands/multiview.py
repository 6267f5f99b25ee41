"""`reconstruct multiview`."""

from pathlib import Path
from typing import Any

import click

from capture_app.terminal import Progress, json_option, print_json, print_line, talk
from capture_app.usage import examples
from reconstruction.commands import options
from reconstruction.session.conditions import SYNCED, Condition


@click.command(
    epilog=examples(
        "reconstruct multiview sessions/burst-001 --out cloud",
        "reconstruct multiview sessions/burst-001 --instant 3 --no-mesh --out cloud",
    )
)
@options.session_argument
@options.instant_option
@click.option(
    "--condition",
    type=options.parse_condition,
    metavar="CONDITION",
    default=SYNCED,
    help=options.CONDITION_HELP,
)
@options.matcher_option
@click.option("--mesh/--no-mesh", default=True, help="Also compute a mesh and render it.")
@options.time_shift_option
@options.out_option
@options.memory_option
@options.checksums_option
@json_option
def multiview(session: Path, condition: Condition, out: Path, as_json: bool, **chosen: Any) -> None:
    """Compute depth maps of all cameras at one instant of SESSION, a point cloud and a mesh."""
    from reconstruction.multiview.command import MultiviewOptions
    from reconstruction.multiview.command import multiview as run
    from reconstruction.session.dataset import Dataset

    dataset = Dataset.open(session, chosen["time_shifts_ms"])
    condition.check(dataset)
    offsets_ms = condition.offsets_ms(dataset.cameras, chosen["instant"])
    wanted = MultiviewOptions(offsets_ms=offsets_ms, **chosen)
    result = run(session, out, wanted, Progress(1))
    for camera, why in result.left_out.items():
        talk(f"{camera} is left out: {why}")
    if as_json:
        print_json(result)
        return
    print_line(f"{len(result.views)} depth maps, {result.fused_points} points in {result.seconds:.1f} s")
    if result.within_2pct is not None:
        print_line(
            f"{result.reference}: {100 * result.within_2pct:.1f} % of its pixels within 2 % of the true depth"
        )
    print_line(f"result: {out}")
