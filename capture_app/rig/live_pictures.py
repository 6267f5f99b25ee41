"""Depth, or people in 3D, while one frames: of previews of one instant, by a process of `reconstruct`."""

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from typing import TypeVar

import msgspec
from msgspec.structs import replace

from capture_app.common.child import Child
from capture_app.common.errors import SimulshotError
from capture_app.common.node_state import NodeState
from capture_app.common.tasks import end
from capture_app.protocol.status import RigStatus
from capture_app.rig.instant_previews import InstantPreviews, instant_previews
from capture_app.rig.rig_link import RigLink
from capture_app.session.format.live_pictures import (
    DEPTH,
    LENGTH,
    PEOPLE,
    WIDTHS_PX,
    DepthPreview,
    InstantImages,
    LiveCameras,
    LivePicture,
    PeoplePreview,
    pack,
)

MAX_FPS = 15.0
"""Instants of previews per second, of which the newest is looked at."""
NICENESS = 1
"""Of the process until its first picture, which a person waits for; then it steps back."""
MAX_LACKING = 20
"""Instants in a row without a picture of the chosen camera after which that is reported."""
COMMAND = ("reconstruction.cli", "live")
TOO_LATE = "its picture came too late"
T = TypeVar("T", bound=LivePicture)


def live_depth(
    link: RigLink, rig: RigStatus, choose: Callable[[], str]
) -> AsyncGenerator[DepthPreview, None]:
    """Yield the depth of the camera that `choose` names; see `_live`."""
    return _live(link, rig, choose, DEPTH, DepthPreview)


def live_people(
    link: RigLink, rig: RigStatus, choose: Callable[[], str]
) -> AsyncGenerator[PeoplePreview, None]:
    """Yield the people in 3D, drawn into the picture of the camera that `choose` names; see `_live`.

    It may name none, by an empty name.
    """
    return _live(link, rig, choose, PEOPLE, PeoplePreview)


async def _live(
    link: RigLink, rig: RigStatus, choose: Callable[[], str], subject: str, kind: type[T]
) -> AsyncGenerator[T, None]:
    """Yield what the process finds, always of the newest instant; nothing during a burst.

    It is computed at low priority; a slow machine skips instants. `link` is used for nothing else, as it
    requests previews. Raises NetworkError if the leader is lost, and the process's own error if it ends.
    """
    newest: asyncio.Queue[InstantPreviews | SimulshotError] = asyncio.Queue(1)

    def hand_over(new: InstantPreviews | SimulshotError) -> None:
        if newest.full():
            newest.get_nowait()
        newest.put_nowait(new)

    async def follow() -> None:
        instants = instant_previews(link, cameras=None, width=WIDTHS_PX[subject], fps=MAX_FPS)
        try:
            async with aclosing(instants):
                async for instant in instants:
                    hand_over(instant)
        except SimulshotError as error:
            hand_over(error)

    child = await Child.start("reconstruct live", COMMAND, niceness=NICENESS)
    task = asyncio.create_task(follow())
    try:
        cameras = {node.name: node.camera for node in rig.cameras}
        await _send(child, LiveCameras(cameras, rig.sessions_folder, subject))
        lacking = 0
        while True:
            instant, camera = await newest.get(), choose()
            if isinstance(instant, SimulshotError):
                raise instant
            jpegs = {name: preview.jpeg for name, preview in instant.previews.items()}
            # A camera that is slow or not synchronized lacks many instants, or all.
            lacking = 0 if not camera or camera in jpegs else lacking + 1
            if not lacking or lacking > MAX_LACKING:
                await _send(child, InstantImages(instant.instant_ns, camera, jpegs))
                found = await _receive(child, kind)
                absent = {
                    name: TOO_LATE if state == NodeState.READY else state
                    for name, state in instant.absent.items()
                }
                yield replace(found, late_ns=instant.age_ns(), absent=absent)
    finally:
        await end(task)
        await child.stop()


async def _send(child: Child, message: msgspec.Struct) -> None:
    """Send the process a message. Raises its error if it has ended."""
    assert child.process.stdin is not None
    try:
        child.process.stdin.write(pack(message))
        await child.process.stdin.drain()
    except ConnectionError as error:
        await child.process.wait()
        raise await child.failure() from error


async def _receive(child: Child, kind: type[T]) -> T:
    """Return the process's next answer. Raises its error if it has ended."""
    assert child.process.stdout is not None
    try:
        size = LENGTH.unpack(await child.process.stdout.readexactly(LENGTH.size))[0]
        return msgspec.msgpack.decode(await child.process.stdout.readexactly(size), type=kind)
    except asyncio.IncompleteReadError as error:
        await child.process.wait()
        raise await child.failure() from error
