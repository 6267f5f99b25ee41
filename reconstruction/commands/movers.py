"""`reconstruct movers`."""

from pathlib import Path

import click

from capture_app.console.terminal import answer, json_option
from capture_app.console.usage import examples
from reconstruction.commands.command_options import (
    out_option,
    session_argument,
)


@click.command(epilog=examples("reconstruct movers sessions/burst-001 --out masks"))
@session_argument
@out_option
@json_option
def movers(session: Path, out: Path, as_json: bool) -> None:
    """Write masks of what moves in SESSION's pictures: white in DIR/CAMERA/INSTANT.png.

    Motion is found by comparing a still camera's pictures of several instants; masks are a few pixels wider.
    """
    from reconstruction.scene.moving_pixels import write_masks
    from reconstruction.scene.scene import Scene

    scene = Scene.open(session)
    moving = write_masks(scene.motion, out)
    masks = sum(len(scene.dataset.instants(camera)) for camera in moving)
    lines = [f"{camera}: {100 * fraction:.1f} % of its pixels move" for camera, fraction in moving.items()]
    answer(as_json, {"masks": masks, "moving": moving}, [*lines, f"{masks} masks: {out}"])
