"""`reconstruct panorama`."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from capture_app.common.text import count
from capture_app.console.terminal import FiniteRange, answer, json_option
from capture_app.console.usage import examples
from reconstruction.commands.command_options import (
    checksums_option,
    instant_option,
    memory_option,
    out_option,
    time_shift_option,
)
from reconstruction.session.conditions import MAX_OFFSET_MS

if TYPE_CHECKING:
    from reconstruction.panorama.overlap import Misalignment


@click.command(
    epilog=examples(
        "reconstruct panorama sessions/burst-001 --out panorama",
        "reconstruct panorama left.jpg right.jpg --out panorama",
    )
)
@click.argument(
    "sources", metavar="SESSION|IMAGE...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@instant_option
@click.option(
    "--offset-ms",
    type=FiniteRange(min=0, min_open=True, max=MAX_OFFSET_MS),
    metavar="MS",
    help="Also stitch with every second camera delayed by this much.",
)
@time_shift_option
@out_option
@memory_option
@checksums_option
@json_option
def panorama(sources: tuple[Path, ...], out: Path, as_json: bool, **options: Any) -> None:
    """Stitch a panorama from one instant of SESSION, or from image files or a folder of them.

    Lists the images that were left out and why, and marks ghosting in the panorama.
    """
    from reconstruction.panorama.panorama_run import PanoramaOptions
    from reconstruction.panorama.panorama_run import panorama as run

    result = run(sources, out, PanoramaOptions(**options))
    made = result.synced
    conditions = [("", made)]
    if result.offset is not None:
        conditions = [(", synchronized", made), (f", {result.actual_offset_ms:.0f} ms late", result.offset)]
    lines = [
        f"panorama of {count(len(result.used), 'image')}, {made.width}x{made.height} pixels",
        *(f"left out: {name}: {why}" for name, why in result.left_out.items()),
        *(
            f"residual where images overlap{which}: {_misalignment_text(one.misfit, one.mover_misfit)}"
            for which, one in conditions
            if one.misfit.median_px is not None
        ),
        f"picture: {out / made.panorama}",
    ]
    answer(as_json, result, lines)


def _misalignment_text(misfit: "Misalignment", moving: "Misalignment | None") -> str:
    text = f"{misfit.median_px:.1f} px at {misfit.points} points (95 % within {misfit.p95_px:.1f})"
    if moving is None or not moving.points + moving.lost:
        return text
    if moving.median_px is None:
        return f"{text}; moving objects lost at all {moving.lost} points"
    text += f"; moving objects {moving.median_px:.1f} px at {moving.points} points"
    return text + (f", lost at {moving.lost}" if moving.lost else "")
