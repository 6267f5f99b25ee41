"""One sentence for the whole rig: what keeps it from being ready and what to do, or how accurate it is."""

from collections.abc import Sequence

from capture_app.node.leader.snapshots import present_cameras
from capture_app.sync.rig.roster import ClientView
from capture_app.sync.wire.messages import NodeState
from capture_app.text import count, duration

_WORST_FIRST = (
    NodeState.FAILED,
    NodeState.LOST,
    NodeState.JOINING,
    NodeState.SYNCING,
    NodeState.ALIGNING,
    NodeState.COARSE,
)
"""Where several nodes are not ready, the one that waits longest for a person is spoken of."""


def rig_advice(views: Sequence[ClientView], leader: str) -> str:
    """Return the one sentence; `leader` is the address that nodes join."""
    for state in _WORST_FIRST:
        concerned = [view for view in views if view.report.state is state]
        if concerned:
            more = "" if len(concerned) == 1 else f" (and {count(len(concerned) - 1, 'more node')})"
            return f"{_shortfall(concerned[0])}{more}"
    cameras = present_cameras(views)
    if not cameras:
        return f"no camera is here: start one with capture-app node --leader {leader} --camera SPEC"
    bars_ns = [view.report.uncertainty_ns for view in cameras if view.report.uncertainty_ns is not None]
    sure = f", clocks sure to ±{duration(max(bars_ns))} (95 %)" if bars_ns else ""
    return f"{count(len(cameras), 'camera')} ready{sure}"


def _shortfall(view: ClientView) -> str:
    """Say how a node is not ready, with its own sentence."""
    state, message = view.report.state, view.report.message
    if state is NodeState.COARSE:
        return f"{view.name}: {message}"
    return f"{view.name} is {state}" + (f": {message}" if message else "")
