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
) -> AsyncGenerator[BoardCoverage | str, None]:
    """Yield the coverage at first and after each change, until it is complete; and lines about the link.

    A line says that the link is lost, another that it is back; the count goes on by itself. Raises
    IncompleteError if the rig has no camera.
    """
    titles = rig.titles
    sizes = {
        titles[node.name]: (node.camera.width, node.camera.height) for node in rig.nodes if node.camera.width
    }
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
        if isinstance(update, LinkLost):
            yield f"{update.reason}; reconnecting, and the count so far is kept"
        elif was_lost:
            yield "the rig is connected again: the count continues"
        if isinstance(update, Preview) and (title := titles.get(update.camera)) in sizes:
            preview = await asyncio.to_thread(decode_preview, update.jpeg)
            now = await asyncio.to_thread(count.add, title, update.leader_ns, preview)
            if now != shown:
                shown = now
                yield shown
            if now.enough:
                return
