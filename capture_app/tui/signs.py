"""Display of camera states, rig states and take grades: always a word, a glyph and a colour; the themes."""

from dataclasses import dataclass

from textual.theme import Theme

from capture_app.common.node_state import NodeState
from capture_app.protocol.status import REPORT_LOST_NS, RigStatus

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
UNKNOWN = Sign("?", "unknown", "$foreground-muted")
"""State of a camera whose leader is lost."""
WAITING = Sign("○", "connecting", "$foreground-muted")
EMPTY = Sign("○", "no camera", "$foreground-muted")

DARK = Theme(
    name="simulshot-dark",
    primary="#7aa2f7",
    secondary="#73daca",
    accent="#bb9af7",
    success="#9ece6a",
    warning="#e0af68",
    error="#f7768e",
    foreground="#c8d0e8",
    background="#16171f",
    surface="#1b1d27",
    panel="#242735",
    dark=True,
    variables={
        "border": "#3b4160",
        "border-blurred": "#2c3046",
        "block-cursor-foreground": "#c8d0e8",
        "block-cursor-background": "#2f3650",
        "block-cursor-text-style": "none",
        "footer-background": "#1b1d27",
        "footer-key-foreground": "#7aa2f7",
        "input-selection-background": "#3d59a1 60%",
    },
)
LIGHT = Theme(
    name="simulshot-light",
    primary="#2e5cc5",
    secondary="#0f7b6c",
    accent="#7847bd",
    success="#3c7a1e",
    warning="#8f5e00",
    error="#b3193f",
    foreground="#2b2f3d",
    background="#f6f6f2",
    surface="#efefe9",
    panel="#e4e4dc",
    dark=False,
    variables={
        "border": "#b6b8c2",
        "border-blurred": "#d2d3da",
        "block-cursor-foreground": "#2b2f3d",
        "block-cursor-background": "#d4dcf3",
        "block-cursor-text-style": "none",
        "footer-background": "#efefe9",
        "footer-key-foreground": "#2e5cc5",
    },
)
PLAIN = Theme(
    name="no-colour",
    ansi=True,
    primary="ansi_default",
    secondary="ansi_default",
    accent="ansi_default",
    success="ansi_default",
    warning="ansi_default",
    error="ansi_default",
    foreground="ansi_default",
    background="ansi_default",
    surface="ansi_default",
    panel="ansi_default",
    boost="ansi_default",
    dark=True,
    variables={
        "ansi-background": "ansi_default",
        "ansi-foreground": "ansi_default",
        "border": "ansi_default",
        "border-blurred": "ansi_default",
        "block-cursor-foreground": "ansi_default",
        "block-cursor-background": "ansi_default",
        # Lists of choices drop "reverse" (Textual 8), and would show no cursor.
        "block-cursor-text-style": "reverse underline",
        "input-cursor-background": "ansi_default",
        "input-cursor-foreground": "ansi_default",
        "input-cursor-text-style": "reverse",
        "scrollbar": "ansi_default",
        "scrollbar-background": "ansi_default",
        "footer-background": "ansi_default",
        "footer-key-foreground": "ansi_default",
    },
)
THEMES = DARK, LIGHT, PLAIN
"""Few colours, each with one meaning, and a theme without colours."""


def rig_sign(status: RigStatus) -> Sign:
    """Return the sign of the whole rig: ready, or the number of ready cameras."""
    here = [node for node in status.cameras if node.state is not NodeState.LOST]
    ready = sum(node.state is NodeState.READY for node in here)
    if not here:
        return EMPTY
    # A rig that has just lost a camera is not shown as ready.
    lost = sum(node.last_seen_ns <= REPORT_LOST_NS for node in status.cameras if node not in here)
    if ready == len(here) and lost:
        return Sign(MISSING, f"{ready} of {ready} ready, {lost} lost", "$warning")
    if ready == len(here):
        return Sign("●", f"{ready} of {ready} ready", "$success")
    failed = any(node.state is NodeState.FAILED for node in here)
    return Sign("✖" if failed else "◑", f"{ready} of {len(here)} ready", "$error" if failed else "$warning")
