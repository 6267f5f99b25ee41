"""Whether a rig is ready for a burst, and what keeps it from being so."""

import asyncio
from collections.abc import AsyncGenerator, Callable, Sequence

from capture_app.errors import IncompleteError
from capture_app.node.leader.snapshots import present_cameras
from capture_app.sync.rig.roster import ClientView
from capture_app.sync.wire.messages import NodeState

CHECK_EVERY_S = 0.1


def why_not_ready(views: Sequence[ClientView], cameras: int) -> str:
    """Say what keeps the rig from being ready, of at least so many cameras; empty when it is."""
    here = [view for view in views if view.report.state is not NodeState.LOST]
    late = [
        f"{view.name} is {view.report.state}" for view in here if view.report.state is not NodeState.READY
    ]
    there = len(present_cameras(views))
    if there < cameras:
        late.append(f"{there} of {cameras} nodes are here")
    return ", ".join(late)


async def reasons_until_ready(
    get_views: Callable[[], Sequence[ClientView]], timeout_s: float, cameras: int
) -> AsyncGenerator[str, None]:
    """Yield what keeps the rig from being ready until it is. Raises IncompleteError when the time is over."""
    loop = asyncio.get_running_loop()
    deadline_s = loop.time() + timeout_s
    while reason := why_not_ready(get_views(), cameras):
        if loop.time() >= deadline_s:
            raise IncompleteError(
                f"not ready after {timeout_s:g} s: {reason}",
                hint="capture-app status shows each node's state",
            )
        yield reason
        # States change with a node's report, which is no event.
        await asyncio.sleep(CHECK_EVERY_S)
