"""Options of a leader or a relay."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from capture_app.common.address import DEFAULT_PORT
from capture_app.common.clock import HostClock, NodeClock
from capture_app.common.stagger import Stagger
from capture_app.common.timeouts import RETURN_NS
from capture_app.node.leader.followers import RigFollower
from capture_app.protocol.log import Log
from capture_app.sync.tree.succession import Continued
from capture_app.trust.trust import Trust


@dataclass(frozen=True, slots=True, kw_only=True)
class PortOptions:
    """Options that leaders and relays share."""

    host: str = "0.0.0.0"  # noqa: S104 - cameras are other machines
    port: int = DEFAULT_PORT
    """Port for UDP and TCP; 0 for a free one."""
    followers: Sequence[RigFollower] = ()
    """Other programs that follow the rig's grid, started and closed together with it."""
    trust: Trust = field(default_factory=Trust.of_user)
    """This process's identity and the machines that it accepts and follows."""
    clock: NodeClock = field(default_factory=HostClock)
    log: Log = field(default_factory=Log)
    """Receives events."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaderOptions(PortOptions):
    """Options of a leader."""

    sessions: Path
    or_free_port: bool = False
    """Whether to use another port if that one is in use."""
    period_ns: int | None = None
    """Frame period; None: the period that most cameras have."""
    align_row: float | None = None
    """Row whose middle of exposure is aligned, as a fraction of the height; None: the first row's start."""
    max_delay_ns: int = 0
    """Maximum delay of a burst that is requested for now, to reach the best predicted alignment."""
    grid_phase_ns: int | None = None
    """Phase of the instants relative to whole periods of leader time; None: set by the cameras."""
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
