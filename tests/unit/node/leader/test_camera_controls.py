"""Exposure, gain, white balance and focus, measured on one camera of a rig and set on all that can."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from msgspec.structs import replace

from capture_app.common.address import Address
from capture_app.common.camera_facts import TIMES, CameraControls, Control
from capture_app.common.errors import BadInputError, IncompleteError
from capture_app.protocol.orders import ControlsAnswer, ControlsRequest
from capture_app.rig.rig_link import ask_leader, ask_status, match_cameras, set_cameras
from tests.cheap_rig import start_leader
from tests.unit.node.camera.controlled_camera import EXPOSURE, GAIN, ControlledCamera, ShownNode
from tests.unit.node.joining import joined
from tests.waiting import until

pytestmark = pytest.mark.virtual

OTHER_GAIN = replace(GAIN, unit=TIMES, value=1.0, minimum=1.0, maximum=8.0)
SHORT = replace(EXPOSURE, value=900.0, maximum=3000.0, automatic=False)


class Rig:
    """A leader and three cameras: `b` has another gain, `c` only a short exposure."""

    def __init__(self, leader: Address) -> None:
        self.leader = leader
        self.cameras = {
            "a": ControlledCamera(),
            "b": ControlledCamera(EXPOSURE, OTHER_GAIN),
            "c": ControlledCamera(SHORT),
        }


@pytest.fixture
async def rig(tmp_path: Path, open_rig: None) -> AsyncIterator[Rig]:
    async with await start_leader(tmp_path) as node:
        made = Rig(node.own_address)
        runs = {name: number for number, name in enumerate(made.cameras, 1)}
        async with joined(node.own_address, *runs.items()):
            tasks = []
            for name, run in runs.items():
                viewfinder = ShownNode(name, run, made.cameras[name]).viewfinder
                viewfinder.set_leader(node.own_address)
                tasks.append(asyncio.create_task(viewfinder.run()))
            for name in runs:
                await _answered(made.leader, name)
            yield made
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


async def _answered(leader: Address, name: str) -> None:
    found: list[CameraControls] = []

    async def ask() -> None:
        while not found:
            try:
                request = ControlsRequest(camera=name, values={})
                found.append((await ask_leader(leader, request, ControlsAnswer)).state)
            except IncompleteError:
                await asyncio.sleep(0.05)

    task = asyncio.create_task(ask())
    await until(lambda: found)
    await task


async def test_all_controls_are_read(rig: Rig) -> None:
    found = await set_cameras(rig.leader, await ask_status(rig.leader), {})
    assert set(found) == {"a", "b", "c"}
    assert found["a"].state(Control.EXPOSURE) == EXPOSURE
    assert [state.control for state in found["c"].controls] == [Control.EXPOSURE]


async def test_what_one_camera_has_chosen_is_set_on_all_that_can(rig: Rig) -> None:
    rig.cameras["a"].choose(4200.0)
    found = await match_cameras(rig.leader, await ask_status(rig.leader), "a")
    exposures = {name: state.state(Control.EXPOSURE) for name, state in found.items()}
    assert {name: state.value for name, state in exposures.items() if state} == {
        "a": 4200.0,
        "b": 4200.0,
        "c": 3000.0,
    }
    assert not any(state.automatic for state in exposures.values() if state)
    assert rig.cameras["a"].set[0] == (Control.EXPOSURE, 4200.0)
    assert found["b"].problems[Control.GAIN] == "its gain is in ×, but was measured in steps of A"
    assert found["b"].problems[Control.WHITE_BALANCE] == "its white-balance cannot be controlled"
    assert "4200 µs is out of its range" in found["c"].problems[Control.EXPOSURE]
    assert (Control.GAIN, 7.0) not in rig.cameras["b"].set


async def test_only_some_controls_are_matched(rig: Rig) -> None:
    found = await match_cameras(rig.leader, await ask_status(rig.leader), "a", [Control.GAIN])
    assert rig.cameras["a"].set == [(Control.GAIN, 7.0)]
    assert rig.cameras["b"].set == []
    assert found["c"].problems == {Control.GAIN: "its gain cannot be controlled"}


async def test_some_cameras_are_set(rig: Rig) -> None:
    await set_cameras(rig.leader, await ask_status(rig.leader), {Control.EXPOSURE: 2000.0}, ["b", "c"])
    assert [camera.set for camera in rig.cameras.values()] == [
        [],
        [(Control.EXPOSURE, 2000.0)],
        [(Control.EXPOSURE, 2000.0)],
    ]
    with pytest.raises(BadInputError, match="has no camera d"):
        await set_cameras(rig.leader, await ask_status(rig.leader), {Control.EXPOSURE: 2000.0}, ["d"])
    with pytest.raises(BadInputError, match="has no camera d"):
        await match_cameras(rig.leader, await ask_status(rig.leader), "d")
