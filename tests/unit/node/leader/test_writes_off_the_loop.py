"""Writes of leaders: none holds up the event loop, and the last state is stored."""

import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from capture_app.common.camera_facts import CameraControls, Control, ControlState
from capture_app.node.leader import camera_settings
from capture_app.node.leader.camera_settings import SETTINGS, CameraSettings
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.viewfinders import Viewfinders
from capture_app.protocol.log import Log
from capture_app.protocol.orders import ControlsAnswer, ControlsRequest
from capture_app.session.files.durable import write_atomic
from capture_app.trust import known_machines
from capture_app.trust.known_machines import CameraNames
from capture_app.trust.trust import Trust
from tests.cheap_rig import start_leader
from tests.unit.node.test_limits import join_many
from tests.waiting import until

Write = Callable[[Path, bytes], None]


def off_this_thread(written: list[Path], before: Callable[[], object] = lambda: None) -> Write:
    """A write that is refused in the thread that makes it, which is the event loop's."""
    loop = threading.get_ident()

    def write(path: Path, data: bytes) -> None:
        assert threading.get_ident() != loop, f"{path.name} is written on the event loop"
        written.append(path)
        before()
        write_atomic(path, data)

    return write


def join(leader: LeaderNode, name: str) -> None:
    join_many(leader, "pin-of-one", [name])
    leader.pump.turn()


async def test_names_that_come_during_a_write_share_the_next_one(
    tmp_path: Path, trust: Trust, leader: LeaderNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A relay's 1,000 hellos made a leader deaf for 20 s: each name waited for the disk."""
    written: list[Path] = []
    all_joined = threading.Event()
    monkeypatch.setattr(known_machines, "write_atomic", off_this_thread(written, lambda: all_joined.wait(30)))
    join(leader, "cam0")
    await until(lambda: written)
    for n in range(1, 50):
        join(leader, f"cam{n}")
    all_joined.set()
    await until(lambda: len(CameraNames(tmp_path / "leader").owners) == 50)
    assert len(written) == 2, "one for the first name, and one for all others"


async def test_names_are_stored_when_a_leader_stops_and_after_an_error_of_the_disk(
    tmp_path: Path, trust: Trust, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(path: Path, data: bytes) -> None:
        raise OSError(28, "No space left on device")

    async with await start_leader(tmp_path / "sessions", trust=trust) as leader:
        with monkeypatch.context() as full:
            full.setattr(known_machines, "write_atomic", fail)
            join(leader, "cam0")
            await until(lambda: any("No space left" in line.text for line in leader.log.after(0)))
        assert CameraNames(tmp_path / "leader").owners == {}
        join(leader, "cam1")
    assert CameraNames(tmp_path / "leader").owners.keys() == {"cam0", "cam1"}


async def test_settings_of_cameras_are_stored_off_the_event_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gain = ControlState(control=Control.GAIN, value=2.0, unit="×", minimum=1.0, maximum=8.0)

    async def answer(*_: object) -> ControlsAnswer:
        return ControlsAnswer(camera="cam0", state=CameraControls(controls=(gain,)))

    written: list[Path] = []
    monkeypatch.setattr(Viewfinders, "ask", answer)
    monkeypatch.setattr(camera_settings, "write_atomic", off_this_thread(written))
    settings = CameraSettings(tmp_path, Viewfinders(), Log())
    await settings.ask(ControlsRequest(camera="cam0", values={Control.GAIN: 2.0}))
    assert written == [tmp_path / SETTINGS]
