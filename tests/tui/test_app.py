"""The screen as a user drives it: keys in, requests to the rig and words on the screen out."""

from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from textual.widgets import Label, RichLog, Static

from capture_app.camera_facts import PhaseControl, TimestampSource
from capture_app.errors import NoCameraHereError
from capture_app.node.wire.status import BurstStatus, NodeStatus, RigStatus
from capture_app.session.format.manifest import BurstRecord, CameraRecord
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.wire.messages import NodeState
from capture_app.text import ProgressStep
from capture_app.tui.app import RigApp
from capture_app.tui.live import Comparison
from capture_app.tui.tables import NodesTable, SessionsTable, gauge
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


@pytest.fixture
def session(tmp_path: Path) -> Path:
    writer = SessionWriter.create(tmp_path, "burst-001")
    camera = CameraRecord(
        name="cam00",
        facts=make_facts(width=4, height=4, period_ns=33_333_000, timestamp_source=TimestampSource.UNKNOWN),
    )
    writer.add_image(
        b"picture",
        camera="cam00",
        instant=0,
        leader_ns=1_000_012_000,
        residual_ns=12_000,
        hard_bound_ns=61_000,
    )
    burst = BurstRecord(instants_ns=(1_000_000_000,), period_ns=33_333_000)
    writer.finish(cameras=(camera,), burst=burst, missing=(), origin="simulated")
    return tmp_path / "burst-001"


def rig_of_five(session: Path | None = None) -> FakeRig:
    rig = FakeRig(session)
    rig.nodes = (
        node("cam00"),
        node("cam01", phase_error_ns=-8_000),
        node("cam02", NodeState.ALIGNING, 7_310_000),
        node("cam03", NodeState.SYNCING, None),
        node("cam04", NodeState.LOST, 40_000, drops=3),
    )
    return rig


def words(app: RigApp) -> str:
    return str(app.query_one("#message", Label).render())


async def settle(app: RigApp, pilot: Any) -> None:
    await app.workers.wait_for_complete()
    app.show_rig()
    await app.workers.wait_for_complete()
    await pilot.pause()


async def test_an_empty_rig_says_how_to_join() -> None:
    app = RigApp(FakeRig())
    async with app.run_test(size=(80, 24)):
        text = str(app.query_one("#empty", Static).render())
        assert "capture-app node --leader 192.168.1.5:47010" in text
        assert not app.query_one(NodesTable).display


async def test_simulated_cameras_are_one_key_away() -> None:
    rig = FakeRig()
    app = RigApp(rig)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("s")
        await settle(app, pilot)
        assert rig.simulated == 5
        assert app.query_one(NodesTable).row_count == 5


async def test_a_burst_appears_among_the_sessions_and_is_compared(session: Path) -> None:
    rig = rig_of_five(session)
    app = RigApp(rig)
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.press("b")
        await settle(app, pilot)
        assert rig.bursts == 1
        assert words(app) == "saved burst-001: 25 of 25 images"
        sessions = app.query_one(SessionsTable)
        assert sessions.selected == session
        row = [str(cell) for cell in sessions.get_row_at(0)]
        assert row == ["burst-001", "1/1", "0 ns ±61 µs", "press c"]
        await pilot.press("c")
        await settle(app, pilot)
        assert rig.compared == [session]
        assert words(app) == "report: report.html"
        log = "\n".join(line.text for line in app.query_one(RichLog).lines)
        assert "burst-001 saved" in log
        assert "98 %" in log


async def test_an_error_is_a_line_on_the_screen_not_a_crash() -> None:
    app = RigApp(FakeRig())
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("b")
        await settle(app, pilot)
        assert words(app) == "no camera is here"
        await pilot.press("c")
        await settle(app, pilot)
        assert words(app) == "no session yet: press b to take a burst"


async def test_cells_follow_the_rig_and_the_width() -> None:
    rig = rig_of_five()
    app = RigApp(rig)
    async with app.run_test(size=(80, 24)) as pilot:
        table = app.query_one(NodesTable)
        await pilot.pause()
        assert [str(column.label) for column in table.ordered_columns][-2:] == ["phase", "drops"]
        assert str(table.get_cell("cam02", "phase")) == "+7.3 ms"
        rig.nodes = (*rig.nodes[:2], node("cam02", phase_error_ns=900), *rig.nodes[3:])
        app.show_rig()
        assert str(table.get_cell("cam02", "phase")) == "+900 ns"
        await pilot.resize_terminal(120, 40)
        app.show_rig()
        assert "model" in [str(column.label) for column in table.ordered_columns]


@pytest.mark.parametrize("size", [(80, 24), (120, 40)])
def test_the_screen_looks_as_it_did(snap_compare: Any, size: tuple[int, int], session: Path) -> None:
    rig = rig_of_five(session)
    rig.sessions = (str(session),)

    async def before(pilot: Any) -> None:
        await settle(pilot.app, pilot)
        for line in ("cam00 joined", "cam04 lost: silent for 2 s", "burst-001: 25 of 25 images"):
            rig.tell(line)

    assert snap_compare(RigApp(rig), terminal_size=size, run_before=before)


def test_the_gauge_shows_milliseconds_and_microseconds_apart() -> None:
    assert gauge(0, 21) == "··········●··········"
    assert gauge(None, 21) == "··········│··········"
    marks = [
        gauge(ns, 21).index("●") for ns in (-16_000_000, -1_000_000, -50_000, 50_000, 1_000_000, 16_000_000)
    ]
    assert marks == sorted(set(marks))


@given(st.integers(-(10**9), 10**9), st.integers(3, 40))
def test_the_gauge_never_leaves_its_line(error_ns: int, width: int) -> None:
    line = gauge(error_ns, width)
    assert len(line) == width
    assert line.count("●") == 1
