"""State of a node, and kinds of node that have no camera."""

from enum import StrEnum

from capture_app.common.text import duration

CLOCK_ONLY = "clock"
"""Kind of a node without a camera that only keeps the time, possibly for clients below it."""
RELAY = "relay"
"""Kind of a relay that forwards its cameras to its parent, and bursts to its cameras."""
WITHOUT_CAMERA = (CLOCK_ONLY, RELAY)


class NodeState(StrEnum):
    """State of a node; ready means that its frames are aligned with the rig's within the requested tolerance.

    A degraded node (DEGRADED) is aligned, but with a larger uncertainty than requested, because of its link.
    """

    JOINING = "joining"
    SYNCING = "syncing"
    ALIGNING = "aligning"
    DEGRADED = "degraded"
    READY = "ready"
    LOST = "lost"
    FAILED = "failed"

    @property
    def is_aligned(self) -> bool:
        """Whether the node is ready or degraded."""
        return self in (NodeState.READY, NodeState.DEGRADED)

    def with_error(self, error_ns: float | None) -> str:
        """Return the state in words; a ready or degraded one with its 95 % error in ns: ready, ±180 µs."""
        if error_ns is None or not self.is_aligned:
            return str(self)
        return f"{self}, ±{duration(error_ns)}"
