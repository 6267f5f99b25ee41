"""How a leader is to run, or a relay."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from capture_app.common.address import DEFAULT_PORT
from capture_app.common.clock import HostClock, NodeClock
from capture_app.common.timeouts import RETURN_NS
from capture_app.node.leader.followers import RigFollower
from capture_app.protocol.news import Log
from capture_app.sync.tree.succession import Continued
from capture_app.trust.trust import Trust


@dataclass(frozen=True, slots=True, kw_only=True)
class PortOptions:
    """What whoever listens for nodes is given by whoever starts it."""

    host: str = "0.0.0.0"  # noqa: S104 - cameras are other machines
    port: int = DEFAULT_PORT
    """UDP and TCP; 0 for a free one."""
    followers: Sequence[RigFollower] = ()
    """Other programs that are told the rig's grid: started and closed with it."""
    trust: Trust = field(default_factory=Trust.of_user)
    """Whom it lets in, and follows."""
    clock: NodeClock = field(default_factory=HostClock)
    news: Log = field(default_factory=Log)
    """Takes what happens."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaderOptions(PortOptions):
    """What a leader is given besides."""

    sessions: Path
    or_free_port: bool = False
    """Another port is taken where that one is in use."""
    period_ns: int | None = None
    """From one frame to the next; None: as most cameras have it."""
    align_row: float | None = None
    """Fraction of the height of the row whose middle of exposure is aligned; None: the first row's start."""
    max_delay_ns: int = 0
    """A burst that is requested for now may be delayed by this to reach the best predicted alignment."""
    grid_phase_ns: int | None = None
    """Instants are this much after whole periods of leader time; None: cameras lay the grid."""
    resume: Sequence[Path] | None = None
    """The interrupted sessions to finish; None for all."""
    continued: Continued | None = None
    """What is taken over of a leader that is gone; `clock` shows its time then."""
    return_ns: int = RETURN_NS
    """How long nodes have to come back with what they hold of them."""
    spool: Path | None = None
    """A folder for the images of nodes on this machine, which operators may have it run then."""
