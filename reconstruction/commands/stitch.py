"""`reconstruct stitch`."""

from pathlib import Path

import click

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
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def stitch(
    sources: tuple[Path, ...], instant: int, offset_ms: float | None, out: Path, as_json: bool
) -> None:
    """Make a panorama of an instant of SESSION, or of pictures or a folder of them.

    Says which pictures were left out and why, and marks where the panorama ghosts.
    """
    import msgspec

    from reconstruction.panorama.command import StitchOptions
    from reconstruction.panorama.command import stitch as run

    result = run(sources, out, StitchOptions(instant=instant, offset_ms=offset_ms))
    if as_json:
        click.echo(msgspec.json.encode(result).decode())
        return
    made = result.synced
    click.echo(f"panorama of {len(result.used)} pictures, {made.width}x{made.height} pixels")
    for name, why in result.left_out.items():
        click.echo(f"left out: {name}: {why}")
    for which, one in (("synchronized", made), (f"{result.actual_offset_ms:.0f} ms late", result.offset)):
        if one is not None and one.ghosting_px is not None:
            click.echo(f"misfit in the overlaps, {which}: {one.ghosting_px:.1f} px")
    click.echo(f"picture: {out / made.panorama}")
