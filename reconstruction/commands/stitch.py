"""`reconstruct stitch`."""

from pathlib import Path

import click

from capture_app.terminal import json_option, print_json, print_line
from reconstruction.commands.arguments import Finite


@click.command()
@click.argument(
    "sources", metavar="SESSION|PICTURES...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option("--instant", type=click.IntRange(min=0), default=0, show_default=True, help="Of a session.")
@click.option(
    "--offset-ms",
    type=Finite(min=0, min_open=True, max=1e6),
    help="Compose it a second time with every second camera so much later, ms.",
)
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for the result.")
@json_option
def stitch(
    sources: tuple[Path, ...], instant: int, offset_ms: float | None, out: Path, as_json: bool
) -> None:
    """Make a panorama of an instant of SESSION, or of pictures or a folder of them.

    Says which pictures were left out and why, and marks where the panorama ghosts.
    """

    from reconstruction.panorama.command import StitchOptions
    from reconstruction.panorama.command import stitch as run

    result = run(sources, out, StitchOptions(instant=instant, offset_ms=offset_ms))
    if as_json:
        print_json(result)
        return
    made = result.synced
    print_line(f"panorama of {len(result.used)} pictures, {made.width}x{made.height} pixels")
    for name, why in result.left_out.items():
        print_line(f"left out: {name}: {why}")
    for which, one in (("synchronized", made), (f"{result.actual_offset_ms:.0f} ms late", result.offset)):
        if one is not None and one.ghosting_px is not None:
            print_line(f"misfit in the overlaps, {which}: {one.ghosting_px:.1f} px")
    print_line(f"picture: {out / made.panorama}")
