"""A rig that a test owns: what it shows and what it answers."""

from collections.abc import AsyncIterator, Callable
from pathlib import Path

from capture_app.camera_facts import PhaseControl
from capture_app.errors import NoCameraHereError
from capture_app.node.wire.status import BurstStatus, NodeStatus, RigStatus
from capture_app.sync.wire.messages import NodeState
from capture_app.text import ProgressStep
from capture_app.tui.source import Comparison
from tests.facts import make_facts

HOUR_NS = 3_600_000_000_000


def node(
    name: str, state: NodeState = NodeState.READY, phase_error_ns: int | None = 12_400, drops: int = 0
) -> NodeStatus:
    return NodeStatus(
        name=name,
        address="192.168.1.7:50112",
        state=state,
        camera=make_facts(model="Simulated phone A", phase_control=PhaseControl.INJECTION),
        offset_ns=4 * HOUR_NS + 720_000_000_000 + len(name),
        hard_bound_ns=61_000,
        uncertainty_ns=9_000,
        round_trip_ns=122_000,
        skew_ppm=-31.25,
        samples=412,
        phase_error_ns=phase_error_ns,
        period_ns=33_333_000,
        drift_ppm=11.0,
        drops=drops,
    )


class FakeRig:
    """Answers as told; `session` is what a burst saves."""

    def __init__(self, session: Path | None = None) -> None:
        self.nodes: tuple[NodeStatus, ...] = ()
        self.sessions: tuple[str, ...] = ()
        self.session = session
        self.bursts = 0
        self.simulated = 0
        self.compared: list[Path] = []
        self.tell: Callable[[str], None] = print

    def status(self) -> RigStatus:
        return RigStatus(
            leader="192.168.1.5:47010",
            now_ns=0,
            period_ns=33_333_000 if self.nodes else None,
            nodes=self.nodes,
            sessions=self.sessions,
        )

    def on_news(self, tell: Callable[[str], None]) -> None:
        self.tell = tell

    async def burst(self, frames: int) -> BurstStatus:
        if not self.nodes:
            raise NoCameraHereError("no camera is here")
        self.bursts += 1
        assert self.session is not None
        self.sessions = (*self.sessions, str(self.session))
        self.tell("burst-001 saved")
        return BurstStatus(
            burst=1, name="burst-001", cameras=5, instants=frames, received=25, expected=25, done=True
        )

    async def add_simulated(self, cameras: int) -> None:
        self.simulated += cameras
        self.nodes = tuple(node(f"cam{n:02d}", NodeState.SYNCING, None) for n in range(cameras))

    async def compare(self, session: Path) -> AsyncIterator[ProgressStep | Comparison]:
        self.compared.append(session)
        yield ProgressStep(1, 2, "stereo")
        yield ProgressStep(2, 2, "report")
        yield Comparison("Synchronized, 98 % of what moves has depth; 66 ms late, 1 %.", Path("report.html"))
