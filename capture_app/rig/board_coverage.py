"""Coverage of the cameras' images by a calibration board in front of a running rig, from its previews."""

import asyncio
from collections.abc import AsyncGenerator

from capture_app.board.boards import DEFAULT_BOARD
from capture_app.board.coverage import BoardCoverage, CoverageCount, PreviewCount
from capture_app.board.detector import Board
from capture_app.common.errors import IncompleteError
from capture_app.protocol.status import Preview, RigStatus
from capture_app.rig.rig_link import LinkLost, RigLink
from capture_app.session.reading.decoding import decode_preview

PREVIEW_PX = 1280
"""Width of the previews in which the board is detected."""


async def watch_coverage(
    link: RigLink, rig: RigStatus, board: Board = DEFAULT_BOARD
) -> AsyncGenerator[BoardCoverage | LinkLost, None]:
    """Yield the coverage at first and after each change, until it is complete; and each loss of the link.

    The link reconnects by itself: then the coverage is yielded again, and the count goes on. Raises
    IncompleteError if the rig has no camera.
    """
    sizes = {node.name: (node.camera.width, node.camera.height) for node in rig.nodes if node.camera.width}
    if not sizes:
        raise IncompleteError(
            f"no camera has joined {rig.leader}",
            hint=f"start one: capture-app node --leader {rig.leader} --camera SPEC",
        )
    count, shown = PreviewCount(board, sizes), CoverageCount(board, sizes).coverage()
    await link.want_previews(cameras=None, width=PREVIEW_PX, fps=3.0)
    yield shown
    is_lost = False
    async for update in link.updates():
        was_lost, is_lost = is_lost, isinstance(update, LinkLost)
        if was_lost and not is_lost:
            yield shown
        if isinstance(update, LinkLost):
            yield update
        elif isinstance(update, Preview) and update.camera in sizes:
            preview = await asyncio.to_thread(decode_preview, update.jpeg)
            now = await asyncio.to_thread(count.add, update.camera, update.leader_ns, preview)
            if now != shown:
                shown = now
                yield shown
            if now.enough:
                return
