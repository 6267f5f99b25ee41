"""The states of a node."""

from enum import StrEnum


class NodeState(StrEnum):
    """Where a node is on its way to taking pictures in step."""

    JOINING = "joining"
    SYNCING = "syncing"
    ALIGNING = "aligning"
    READY = "ready"
    LOST = "lost"
    FAILED = "failed"
