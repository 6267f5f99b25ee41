"""What the rig's screens look like: three sizes, dark, light and without colour, with the clock at rest.

`pytest tests/unit/tui/test_looks.py --snapshot-update` takes the pictures again.
"""

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.node_state import NodeState
from capture_app.plugins.cameras.v4l2 import v4l2_driver
from capture_app.protocol.status import LogLine, NodeDetail
from capture_app.tui.rig_record import RigRecord
from capture_app.tui.screen_settings import Settings
from tests.unit.tui.driving import make_app, settle
from tests.unit.tui.fake_rig import UNIX_NS, FakeRig, make_node

pytestmark = pytest.mark.usefixtures("utc")

SMALL, MIDDLE, LARGE = (80, 24), (120, 40), (200, 50)
DARK, LIGHT, PLAIN = "simulshot-dark", "simulshot-light", "no-colour"
DETAIL = NodeDetail(
    camera="cam00",
    samples=tuple((5_000_000 + (n * 7919 % 41 - 20) * n * 4, 120_000 + 300 * n) for n in range(200)),
    phase_errors_ns=tuple((n * 7919 % 101 + n * 104_729 % 97 - 98) * 700 for n in range(300)),
    log=tuple(
        LogLine(unix_ns=UNIX_NS + n * 10**9, text=text)
        for n, text in enumerate(("joining: asks to join", "syncing", "aligning: +7.3 ms to go", "ready"))
    ),
    spool="/var/spool/simulshot",
)

Play = Callable[[FakeRig, list[float], Any], Awaitable[None]]


async def come_home(rig: FakeRig, now: list[float], pilot: Any) -> None:
    """Half a minute in which phases come into their band, one camera is lost and one fails."""
    await settle(pilot)
    nodes = rig.nodes
    for step in range(8):
        now[0] += 3.7
        rig.nodes = tuple(
            make_node(node.name, node.state, phase_error_ns=node.phase_error_ns + _away_ns(step - place))
            if node.phase_error_ns is not None and node.state is not NodeState.LOST
            else node
            for place, node in enumerate(nodes)
        )
        rig.tell()
        await pilot.pause()
    words = "Its exposure is too long."
    last = make_node(nodes[-2].name, NodeState.FAILED, phase_error_ns=None, message=words)
    rig.nodes = (*rig.nodes[:-2], last, rig.nodes[-1])
    rig.different["advice"] = f"{last.name} failed: its exposure is longer than a frame; set it to 1/60 s."
    for text in ("cam00 joined", "cam01 joined", "burst-001 saved: 25 of 25 images"):
        rig.news(text)
    rig.news("lost cam04: silent for 2 s", level="warning", camera="cam04")
    rig.tell()
    await settle(pilot)


def _away_ns(step: int) -> int:
    """How far a phase still is from where it ends up."""
    return round(12_000_000 * 0.4**step) % 16_000_000


async def look_closely(rig: FakeRig, now: list[float], pilot: Any) -> None:
    await settle(pilot)
    await pilot.press("enter")
    await settle(pilot)


async def ask_for_help(rig: FakeRig, now: list[float], pilot: Any) -> None:
    await settle(pilot)
    await pilot.press("question_mark")
    await settle(pilot)


async def quit_it(rig: FakeRig, now: list[float], pilot: Any) -> None:
    rig.nodes = tuple(make_node(f"cam{n:02d}", on_leader=True) for n in range(3))
    rig.tell()
    await settle(pilot)
    await pilot.press("q")
    await settle(pilot)


@pytest.mark.parametrize(
    ("cameras", "size", "theme", "play"),
    [
        pytest.param(5, SMALL, DARK, come_home, id="rig"),
        pytest.param(20, LARGE, DARK, come_home, id="rig-of-20-large"),
        pytest.param(5, LARGE, LIGHT, look_closely, id="camera-large-light"),
        pytest.param(5, SMALL, DARK, ask_for_help, id="help"),
        pytest.param(5, SMALL, PLAIN, quit_it, id="quit-plain"),
    ],
)
def test_a_screen_looks_as_it_did(
    snap_compare: Any, cameras: int, size: tuple[int, int], theme: str, play: Play
) -> None:
    rig, now = FakeRig(cameras), [100.0]
    rig.details["cam00"] = DETAIL
    app = make_app(rig, settings=Settings(choices={"theme": theme}), record=RigRecord(lambda: now[0]))

    async def before(pilot: Any) -> None:
        await play(rig, now, pilot)

    assert snap_compare(app, terminal_size=size, run_before=before)


def test_the_start_looks_as_it_did(
    snap_compare: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(v4l2_driver, "list_cameras", list)
    app = make_app(FakeRig(0), settings=Settings(choices={"theme": LIGHT}), sessions=tmp_path)

    async def before(pilot: Any) -> None:
        await settle(pilot)
        for worker in [worker for worker in app.workers if worker.group == "offers"]:
            await worker.wait()
        await settle(pilot)

    assert snap_compare(app, terminal_size=MIDDLE, run_before=before)
