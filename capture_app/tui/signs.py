"""Display of camera states, rig states and take grades: always a word, a glyph and a colour."""

from dataclasses import dataclass

from capture_app.common.node_state import WITHOUT_CAMERA, NodeState
from capture_app.protocol.status import REPORT_LOST_NS, NodeStatus, RigStatus

MISSING = "!"
"""Glyph of a rig whose connected cameras are ready after one was recently lost."""


@dataclass(frozen=True, slots=True)
class Sign:
    """Glyph, word and style of a state."""

    glyph: str
    word: str
    style: str
    """Style of the theme, such as $success."""

    def __str__(self) -> str:
        """Return the glyph and the word."""
        return f"{self.glyph} {self.word}"


SIGNS = {
    NodeState.JOINING: Sign("○", "joining", "$foreground-muted"),
    NodeState.SYNCING: Sign("◔", "syncing", "$warning"),
    NodeState.ALIGNING: Sign("◑", "aligning", "$warning"),
    NodeState.DEGRADED: Sign("◕", "degraded", "$warning"),
    NodeState.READY: Sign("●", "ready", "$success"),
    NodeState.LOST: Sign("◌", "lost", "$foreground-muted"),
    NodeState.FAILED: Sign("✖", "failed", "$error"),
}
GRADES = {
    "excellent": Sign("●", "excellent", "$success"),
    "good": Sign("◕", "good", "$success"),
    "fair": Sign("◑", "fair", "$warning"),
    "poor": Sign("○", "poor", "$error"),
    "unknown": Sign("–", "not measured", "$foreground-muted"),
}
"""Grades of a take, in every mode; `GRADE_LIMITS` defines the words."""
NO_LEADER = Sign("✖", "leader lost", "$error")
WAITING = Sign("○", "connecting", "$foreground-muted")
EMPTY = Sign("○", "no camera", "$foreground-muted")


def cameras_of(status: RigStatus) -> tuple[NodeStatus, ...]:
    """Return the nodes with a camera, without relays and clocks."""
    return tuple(node for node in status.nodes if node.camera.kind not in WITHOUT_CAMERA)


def is_settled(node: NodeStatus) -> bool:
    """Return whether a camera is synchronized; includes brief phase corrections."""
    close = abs(node.phase_error_ns or 0) <= 2 * node.tolerance_ns
    return close and node.state in (NodeState.READY, NodeState.ALIGNING)


def rig_sign(status: RigStatus) -> Sign:
    """Return the sign of the whole rig: ready, or the number of ready cameras."""
    here = [node for node in cameras_of(status) if node.state is not NodeState.LOST]
    ready = sum(node.state is NodeState.READY for node in here)
    if not here:
        return EMPTY
    # A rig that has just lost a camera is not shown as ready.
    lost = sum(node.last_seen_ns <= REPORT_LOST_NS for node in cameras_of(status) if node not in here)
    if ready == len(here) and lost:
        return Sign(MISSING, f"{ready} of {ready} ready, {lost} lost", "$warning")
    if ready == len(here):
        return Sign("●", f"{ready} of {ready} ready", "$success")
    failed = any(node.state is NodeState.FAILED for node in here)
    return Sign("✖" if failed else "◑", f"{ready} of {len(here)} ready", "$error" if failed else "$warning")
