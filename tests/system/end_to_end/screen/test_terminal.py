"""The whole way of a first user, in a real terminal: keys typed, screen read."""

import json
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from capture_app.common.node_state import NodeState
from capture_app.protocol.orders import StopRig
from capture_app.rig.process import list_rigs
from capture_app.rig.rig_link import ask_status, give_order
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify

from .terminal import Terminal, require_tmux


@pytest.fixture
async def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[dict[str, str]]:
    """A user without any settings; rigs that are left running are stopped."""
    require_tmux()
    folders = {
        name: str(tmp_path / name.lower()) for name in ("XDG_STATE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME")
    }
    for name, folder in folders.items():
        monkeypatch.setenv(name, folder)
    yield folders
    for rig in list_rigs():
        await give_order(rig.address, StopRig())


async def test_a_first_user_takes_compares_and_exports_by_keys_alone(
    home: dict[str, str], tmp_path: Path
) -> None:
    here = ("--host", "127.0.0.1", "--sessions", "takes", "--frames", "4")
    async with Terminal(*here, environment=home, folder=tmp_path) as terminal:
        await terminal.shows("Starting the screen")
        await terminal.shows("Add cameras", "Try 5 simulated cameras")
        terminal.press("-", "-", "-")
        await terminal.shows("Try 2 simulated cameras")
        terminal.press("s")
        await terminal.shows("2 cameras ready")

        terminal.press("2")
        await terminal.shows("Next take")
        terminal.press("Space")
        # The verdict of the take, and its contact sheet: cameras across, instants down.
        await terminal.shows("µs ±", "instant cam00", "first", "+33 ms")

        terminal.press("3")
        await terminal.shows("burst-001", "2 cameras × 4 instants")
        terminal.press("c")
        await terminal.shows("compare")
        terminal.press("e")
        await terminal.shows("Export burst-001")
        terminal.press("Enter")
        await terminal.shows("Folder to write, new or empty")
        terminal.press("Enter")
        await terminal.shows("✔ export to colmap")
        terminal.press("4")
        await terminal.shows(
            "✔ done           Compare  burst-001", "✔ done           Export to colmap  burst-001"
        )

        terminal.press("3")
        await terminal.shows("2 cameras × 4 instants")
        terminal.press("R")
        await terminal.shows("● synchronized", "○ 67 ms late")
        terminal.press("Space")
        await terminal.shows("○ synchronized", "● 67 ms late")
        terminal.press("Escape")
        await terminal.shows("2 cameras × 4 instants")

        terminal.press("q")
        await terminal.shows("Leave the rig running", "Stop the rig")
        terminal.press("s")
        assert await terminal.ends() == 0
        assert "The rig is stopped." in terminal.screen
    assert list_rigs() == []
    session = Session.open(tmp_path / "takes" / "burst-001")
    assert verify(session) == []
    results = tmp_path / "takes" / "_results" / "burst-001" / "compare"
    assert "verdict" in json.loads((results / "metrics.json").read_text())
    exported = tmp_path / "burst-001-colmap"
    assert len(list(exported.glob("images/**/*.jpg"))) == len(session.manifest.images)


async def test_a_killed_screen_leaves_rig_and_take_whole_and_the_next_finds_both(
    home: dict[str, str], tmp_path: Path
) -> None:
    camera = ("--camera", "sim:perfect,scale=0.2", "--camera", "sim:phone-b,scale=0.2,drops=0")
    here = ("--host", "127.0.0.1", "--sessions", "takes", *camera)
    async with Terminal(*here, environment=home, folder=tmp_path) as first:
        await first.shows("2 cameras ready")
        first.press("2")
        await first.shows("Next take")
        first.press("Space")
        await first.shows("burst-001")
        first.kill()
    (rig,) = list_rigs()
    nodes = (await ask_status(rig.address)).nodes
    assert [node.name for node in nodes if node.state is not NodeState.LOST] == ["perfect", "phone-b"]
    async with Terminal(environment=home, folder=tmp_path) as again:
        await again.shows("2 cameras ready")
        again.press("3")
        await again.shows("burst-001")
        again.press("q")
        await again.shows("Leave the rig running", "Stop the rig")
        again.press("s")
        assert await again.ends() == 0
    assert list_rigs() == []
    session = Session.open(tmp_path / "takes" / "burst-001")
    assert verify(session) == []
    assert {image.camera for image in session.manifest.images} == {"perfect", "phone-b"}
