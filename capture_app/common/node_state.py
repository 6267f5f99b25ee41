"""State of a node, and kinds of node that have no camera."""

from enum import StrEnum

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
