"""`capture-app preview`: a small live image of a camera of a rig."""

import asyncio
from contextlib import aclosing, suppress
from pathlib import Path
from typing import Any

import click

from capture_app.commands.shared_options import leader_option
from capture_app.common.address import Address
from capture_app.common.errors import IncompleteError, NetworkError, SimulshotError
from capture_app.console.option_rules import Rule, RuledCommand
from capture_app.console.terminal import FiniteRange, answer, json_option
from capture_app.console.usage import examples


@click.command(
    cls=RuledCommand,
    rules=(Rule("--width", "!--depth"),),
    epilog=examples("capture-app preview cam0", "capture-app preview cam0 --width 1280 --out view.jpg"),
)
@click.argument("camera")
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    show_default="CAMERA.jpg",
    help="JPEG file to write; an existing one is replaced.",
)
@click.option("--depth", is_flag=True, help="Save its depth instead, if the rig is calibrated.")
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
def preview(
    camera: str, out: Path | None, depth: bool, width: int, wait_s: float, leader: Address, as_json: bool
) -> None:
    """Save a small live picture of CAMERA, and print the path of the file.

    A preview waits while a burst is taken or sent.
    """
    facts, jpeg = asyncio.run(_next_preview(leader, camera, width, wait_s, depth=depth))
    path = out or Path(f"{camera}.jpg")
    try:
        path.write_bytes(jpeg)
    except OSError as error:
        raise SimulshotError(f"cannot write {path}: {error.strerror}", hint="choose another --out") from error
    answer(as_json, facts | {"file": str(path)}, [str(path)])


async def _next_preview(
    leader: Address, camera: str, width: int, wait_s: float, *, depth: bool
) -> tuple[dict[str, Any], bytes]:
    """Return the facts and the JPEG of a camera's next preview, or of its depth."""
    from capture_app.protocol.status import Preview
    from capture_app.rig.rig_link import LinkLost, RigLink, ask_status, camera_named

    status = await ask_status(leader)
    typed, camera, known = camera, camera_named(status, camera), status.titles
    if camera not in known:
        raise IncompleteError(
            f"{leader} has no camera named {typed}",
            hint=f"cameras: {', '.join(known.values())}" if known else "no camera has joined it",
        )
    link = RigLink(leader)
    with suppress(TimeoutError):
        async with asyncio.timeout(wait_s):
            if depth:
                from capture_app.rig.live_pictures import live_depth

                async with aclosing(live_depth(link, status, lambda: camera)) as depths:
                    pictures = await anext(depths)
                if pictures.problem:
                    raise IncompleteError(pictures.problem)
                facts = {"leader_ns": pictures.instant_ns, "moving_confirmed": pictures.moving_confirmed}
                return {"camera": camera, **facts}, pictures.jpeg
            await link.want_previews(cameras=(camera,), width=width, fps=5)
            async for update in link.updates():
                if isinstance(update, Preview):
                    facts = {"leader_ns": update.leader_ns, "width": update.width, "height": update.height}
                    return {"camera": camera, **facts}, update.jpeg
                if isinstance(update, LinkLost):
                    raise NetworkError(update.reason, hint="look for the leader: capture-app rig list")
    raise IncompleteError(
        f"{typed} sent no picture within {wait_s:g} s", hint="see its state: capture-app status"
    )
