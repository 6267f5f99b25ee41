"""What is noted of a virtual evening, to be judged by `invariants`."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from capture_app.node.burst.burst_session import BurstSession
from capture_app.protocol.status import BurstStatus
from capture_app.rig.rig_time import PlacedMark
from capture_app.session.reading.verdict import Verdict
from capture_app.sync.rig.frame_selection import Burst
from tests.virtual.plan import Step


@dataclass(frozen=True, slots=True)
class Told:
    """What an operator was told of a saved take, and what was on the disk at that moment."""

    status: BurstStatus
    received: int
    """Images that its leader had counted when the take was over; 0 if the operator had lost the leader."""
    expected: int
    """Images that its leader expected then; 0 if the operator had lost the leader."""
    verdict: Verdict | None
    images: int
    missing: int
    """Images that the session lists as missing; -1 if it could not be read."""
    absent: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class MarkOfDesk:
    """A mark as an operator placed it; the true time is that of the call."""

    text: str
    true_ns: int
    over_ns: int
    """True time when the leader had answered."""
    machine: str
    clock: Any
    placed: PlacedMark


@dataclass(slots=True)
class OrderedBurst:
    """A burst as its leader ordered it, and what may excuse a missing image of it."""

    key: tuple[int, int]
    name: str
    burst: Burst
    clock: Any
    """The leader's clock."""
    ordered_ns: int
    """True time of the order."""
    ready: tuple[str, ...]
    folder: Path
    machine: str
    session: BurstSession
    seen: frozenset[str]
    """Cameras that operators saw ready in this run of the leader, before the order."""
    cancel_asked_ns: int | None = None
    """True time when an operator asked to cancel it."""
    cancelled_ns: int | None = None
    """True time when the leader had confirmed that."""
    end_asked_ns: int | None = None
    """True time when an operator asked to end it."""
    is_ended: bool = False
    """Whether the leader has confirmed that."""

    def last_ns(self) -> int:
        """True time of the last instant."""
        instants = self.session.burst.instants_ns
        return int(self.clock.true_from_local(instants[-1]))


@dataclass(slots=True)
class Take:
    """What an operator was told of a take."""

    step: Step
    begun_ns: int
    status: BurstStatus | None = None
    result: str = ""
    """"saved", or the error."""
    told: list[Told] = field(default_factory=list)


@dataclass(slots=True)
class Span:
    """A fault: from when to when it befell a machine."""

    target: str
    kind: str
    from_ns: int
    until_ns: int


@dataclass(frozen=True, slots=True)
class TimeError:
    """Error of an image's leader time, and what the session states of it; in ns."""

    camera: str
    burst: tuple[int, int]
    error_ns: int
    uncertainty_ns: int
    is_typical: bool
    """Whether link and clocks are such as the uncertainty assumes."""


@dataclass
class Evidence:
    """What is needed to judge a run."""

    bursts: list[OrderedBurst] = field(default_factory=list)
    takes: list[Take] = field(default_factory=list)
    spans: list[Span] = field(default_factory=list)
    confirmed: dict[tuple[int, int, str, int], tuple[str, int]] = field(default_factory=dict)
    """Images that a node counts as safe with its leader, with checksum and true time of the confirmation: by
    leader's run, burst, camera, ordered instant."""
    synced: dict[tuple[int, int, str, int], tuple[str, int]] = field(default_factory=dict)
    """Images that a node counts as safe in its own spool, as `confirmed`."""
    led: list[tuple[int, str]] = field(default_factory=list)
    """True times from which a machine leads, with the machine."""
    aligned: list[tuple[str, str, int]] = field(default_factory=list)
    """Cameras that have become ready at a leader, with its machine and the true time."""
    marks: list[MarkOfDesk] = field(default_factory=list)
    log_lines: Counter[str] = field(default_factory=Counter)
