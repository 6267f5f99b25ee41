"""The state of a camera or a rig, or the grade of a take: a word, a glyph, a colour; never colour alone."""

from dataclasses import dataclass

from capture_app.common.node_state import WITHOUT_CAMERA, NodeState
from capture_app.protocol.status import LOST_IS_NEWS_NS, NodeStatus, RigStatus

MISSING = "!"
"""The glyph of a rig whose cameras are ready, but one of which was lost a short while ago."""


@dataclass(frozen=True, slots=True)
class Sign:
    """How a state is shown."""

    glyph: str
    word: str
    style: str
    """A style of the theme, such as $success."""

    def __str__(self) -> str:
        """The glyph and the word."""
        return f"{self.glyph} {self.word}"


SIGNS = {
    NodeState.JOINING: Sign("○", "joining", "$foreground-muted"),
    NodeState.SYNCING: Sign("◔", "syncing", "$warning"),
    NodeState.ALIGNING: Sign("◑", "aligning", "$warning"),
    NodeState.COARSE: Sign("◕", "coarse", "$warning"),
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
"""How good a take is, in every mode; `GRADE_LIMITS` says what the words mean."""
NO_LEADER = Sign("✖", "leader lost", "$error")
WAITING = Sign("○", "connecting", "$foreground-muted")
EMPTY = Sign("○", "no camera", "$foreground-muted")


def cameras_of(status: RigStatus) -> tuple[NodeStatus, ...]:
    """The nodes that take pictures: relays and clocks do not."""
    return tuple(node for node in status.nodes if node.camera.kind not in WITHOUT_CAMERA)


def is_settled(node: NodeStatus) -> bool:
    """Whether a camera is in step; one that touches up its phase for a moment is, too."""
    close = abs(node.phase_error_ns or 0) <= 2 * node.tolerance_ns
    return close and node.state in (NodeState.READY, NodeState.ALIGNING)


def rig_sign(status: RigStatus) -> Sign:
    """How far the whole rig is: ready, or how many of its cameras are."""
    here = [node for node in cameras_of(status) if node.state is not NodeState.LOST]
    gone = [node for node in cameras_of(status) if node.state is NodeState.LOST]
    ready = sum(node.state is NodeState.READY for node in here)
    if not here:
        return EMPTY
    # A rig that has just lost one is not simply ready.
    lost = sum(node.last_seen_ns <= LOST_IS_NEWS_NS for node in gone)
    if ready == len(here) and lost:
        return Sign(MISSING, f"{ready} of {ready} ready, {lost} lost", "$warning")
    if ready == len(here):
        return Sign("●", f"{ready} of {ready} ready", "$success")
    failed = any(node.state is NodeState.FAILED for node in here)
    return Sign("✖" if failed else "◑", f"{ready} of {len(here)} ready", "$error" if failed else "$warning")
