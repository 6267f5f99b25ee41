"""`capture-app preview`: a small live image of a camera of a rig."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

import click

from capture_app.commands.shared_options import leader_option
from capture_app.common.address import Address
from capture_app.common.errors import IncompleteError, NetworkError, SimulshotError
from capture_app.console.terminal import FiniteRange, answer, json_option
from capture_app.console.usage import examples

if TYPE_CHECKING:
    from capture_app.protocol.status import Preview


@click.command(
    epilog=examples("capture-app preview cam0", "capture-app preview cam0 --width 1280 --out view.jpg")
)
@click.argument("camera")
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    show_default="CAMERA.jpg",
    help="JPEG file to write; an existing one is replaced.",
)
@click.option(
    "--width", type=click.IntRange(16, 1920), metavar="PX", default=640, help="Maximum width of the picture."
)
@click.option(
    "--wait-s",
    type=FiniteRange(0.1, 3600.0),
    metavar="S",
    default=10.0,
    help="Wait for the picture up to this long.",
)
@leader_option
@json_option
def preview(camera: str, out: Path | None, width: int, wait_s: float, leader: Address, as_json: bool) -> None:
    """Save a small live picture of CAMERA, and print the path of the file.

    A preview waits while a burst is taken or sent.
    """
    seen = asyncio.run(_next_preview(leader, camera, width, wait_s))
    path = out or Path(f"{camera}.jpg")
    try:
        path.write_bytes(seen.jpeg)
    except OSError as error:
        raise SimulshotError(f"cannot write {path}: {error.strerror}", hint="choose another --out") from error
    facts = {"camera": seen.camera, "leader_ns": seen.leader_ns, "width": seen.width, "height": seen.height}
    answer(as_json, facts | {"file": str(path)}, [str(path)])


async def _next_preview(leader: Address, camera: str, width: int, wait_s: float) -> "Preview":
    from capture_app.protocol.status import Preview
    from capture_app.rig.rig_link import LinkLost, RigLink, ask_status

    known = [node.name for node in (await ask_status(leader)).nodes]
    if camera not in known:
        there = f"cameras: {', '.join(known)}" if known else "no camera has joined it"
        raise IncompleteError(f"{leader} has no camera named {camera}", hint=there)
    link = RigLink(leader)
    await link.want_previews(cameras=(camera,), width=width, fps=5)
    try:
        async with asyncio.timeout(wait_s):
            async for update in link.updates():
                if isinstance(update, Preview):
                    return update
                if isinstance(update, LinkLost):
                    raise NetworkError(update.reason, hint="look for the leader: capture-app rig list")
    except TimeoutError:
        pass
    raise IncompleteError(
        f"{camera} sent no picture within {wait_s:g} s", hint="see its state: capture-app status"
    )
