"""Options of a leader."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from capture_app.common.stagger import Stagger
from capture_app.common.timeouts import RETURN_NS
from capture_app.node.endpoint import PortOptions
from capture_app.node.followers import Follower
from capture_app.sync.tree.succession import Continued


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaderOptions(PortOptions):
    """Options of a leader."""

    sessions: Path
    followers: Sequence[Follower] = ()
    """Other programs that follow the rig, started and closed together with it."""
    or_free_port: bool = False
    """Whether to use another port if that one is in use."""
    period_ns: int | None = None
    """Frame period; None: the period that most cameras have."""
    align_row: float | None = None
    """Row whose middle of exposure is aligned, as a fraction of the height; None: the first row's start."""
    stagger: Stagger | None = None
    """Planned order of the cameras' frames; None: all at the same instant."""
    resume: Sequence[Path] | None = None
    """Interrupted sessions to finish; None for all."""
    continued: Continued | None = None
    """State taken over from a lost leader; `clock` then shows that leader's time."""
    awaited: Sequence[str] = ()
    """Names of the cameras that the lost leader had."""
    return_ns: int = RETURN_NS
    """Time that nodes have to return with images of those sessions."""
    spool: Path | None = None
    """Folder for images of nodes on this machine; operators may start such nodes only if it is given."""
