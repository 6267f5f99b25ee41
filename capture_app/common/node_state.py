"""State of a node, and kinds of node that have no camera."""

from enum import StrEnum

CLOCK_ONLY = "clock"
"""The kind of a node without a camera that only keeps the time, perhaps for clients below it."""
RELAY = "relay"
"""The kind of a relay that passes its cameras on to its parent, and bursts to its cameras."""
WITHOUT_CAMERA = (CLOCK_ONLY, RELAY)


class NodeState(StrEnum):
    """How far a node is: ready when its frames are aligned with those of the rig, as well as was asked for.

    A coarse one is aligned by a clock that its link does not let it know as well as that.
    """

    JOINING = "joining"
    SYNCING = "syncing"
    ALIGNING = "aligning"
    COARSE = "coarse"
    READY = "ready"
    LOST = "lost"
    FAILED = "failed"
