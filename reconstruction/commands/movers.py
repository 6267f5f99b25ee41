"""`reconstruct movers`."""

from pathlib import Path

import click

from capture_app.console.terminal import answer, json_option
from capture_app.console.usage import examples
from reconstruction.commands.options import checksums_option, memory_option, out_option, session_argument


@click.command(epilog=examples("reconstruct movers sessions/burst-001 --out masks"))
@session_argument
@out_option
@memory_option
@checksums_option
@json_option
def movers(session: Path, out: Path, as_json: bool) -> None:
    """Write masks of what moves in SESSION's pictures: white in DIR/CAMERA/INSTANT.png.

    What moves is seen by a still camera's pictures of other instants; the masks are a few pixels wider.
    """
    from reconstruction.session.dataset import Dataset
    from reconstruction.session.motion import SceneMotion, write_masks

    result = write_masks(SceneMotion(Dataset.open(session), step=1), out)
    moving = (f"{camera}: {100 * share:.1f} % of its pixels move" for camera, share in result.moving.items())
    answer(as_json, result, [*moving, f"{result.masks} masks: {out}"])
