import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import cast

import pytest

from capture_app.common.camera_facts import Control
from capture_app.node.camera.supervisor import CameraSupervisor, ControlKeeper
from tests.unit.node.camera.controlled_camera import EXPOSURE, ControlledCamera, Holder
from tests.waiting import until

pytestmark = pytest.mark.virtual


class Node(Holder):
    """A camera that may be opened anew, its keeper, and what a node hears of it."""

    camera: ControlledCamera

    def __init__(self) -> None:
        super().__init__(ControlledCamera())
        self.keeper = ControlKeeper(cast(CameraSupervisor, self))


@pytest.fixture
async def node() -> AsyncIterator[Node]:
    made = Node()
    running = asyncio.create_task(made.keeper.run())
    yield made
    running.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await running


async def see_it_choose(node: Node) -> None:
    """Wait until the keeper has seen that the driver tells what the camera chooses."""
    camera, at = node.camera, 4000.0
    for _ in range(2):
        at += 100.0
        camera.choose(at)
        # A burst that begins and ends makes it look at once.
        node.keeper.set_in_burst(True)
        await asyncio.sleep(0)
        node.keeper.set_in_burst(False)
        await settled(node)


async def settled(node: Node) -> None:
    for _ in range(20):
        await asyncio.sleep(0)
    await node.keeper.read()


async def test_a_value_is_set_and_told(node: Node) -> None:
    done = await node.keeper.apply({Control.EXPOSURE: 2500.0, Control.GAIN: 3.0})
    assert done.problems == {}
    exposure = done.state(Control.EXPOSURE)
    assert exposure is not None
    assert (exposure.value, exposure.automatic) == (2500.0, False)
    assert node.camera.set == [(Control.EXPOSURE, 2500.0), (Control.GAIN, 3.0)]
    assert node.changes == 1


async def test_what_cannot_be_set_is_told_with_its_reason(node: Node) -> None:
    wanted = {Control.EXPOSURE: 90_000.0, Control.WHITE_BALANCE: 4000.0, Control.FOCUS: 1.0}
    done = await node.keeper.apply(wanted)
    assert done.problems == {
        Control.EXPOSURE: "90000 µs is out of its range, 100 to 30000",
        Control.WHITE_BALANCE: "its white-balance cannot be set",
        Control.FOCUS: "its focus cannot be controlled",
    }
    assert node.camera.set == [(Control.EXPOSURE, 30_000.0)]


async def test_a_driver_that_refuses_is_told(node: Node) -> None:
    node.camera.refuses_to_set = True
    done = await node.keeper.apply({Control.GAIN: 3.0})
    assert "the device is gone" in done.problems[Control.GAIN]


async def test_a_camera_that_is_gone_ends_nothing(node: Node) -> None:
    await see_it_choose(node)
    node.camera.refuses = True
    assert (await node.keeper.read()).controls == ()
    done = await node.keeper.apply({Control.GAIN: 3.0})
    assert done.problems == {Control.GAIN: "its gain cannot be controlled"}
    node.keeper.set_in_burst(True)
    await settled(node)
    node.keeper.set_in_burst(False)
    await settled(node)
    node.camera = ControlledCamera()
    assert len((await node.keeper.read()).controls) == 3


async def test_automatic_where_the_camera_can(node: Node) -> None:
    await node.keeper.apply({Control.EXPOSURE: 2500.0})
    done = await node.keeper.apply({Control.EXPOSURE: "auto", Control.GAIN: "auto"})
    assert done.problems == {Control.GAIN: "it has no automatic gain"}
    assert node.camera.set[-1] == (Control.EXPOSURE, None)


async def test_hold_keeps_what_is(node: Node) -> None:
    await see_it_choose(node)
    node.camera.choose(4444.0)
    done = await node.keeper.apply({Control.EXPOSURE: "hold", Control.GAIN: "hold"})
    assert done.problems == {}
    assert node.camera.set == [(Control.EXPOSURE, 4444.0), (Control.GAIN, 7.0)]


async def test_hold_says_where_the_driver_may_not_tell(node: Node) -> None:
    done = await node.keeper.apply({Control.EXPOSURE: "hold"})
    assert "check whether the picture has changed" in done.problems[Control.EXPOSURE]


async def test_a_camera_that_was_opened_anew_is_set_again(node: Node) -> None:
    await node.keeper.apply({Control.EXPOSURE: 2500.0, Control.GAIN: 3.0})
    await node.keeper.apply({Control.EXPOSURE: "auto"})
    node.camera = ControlledCamera()
    await node.keeper.restore()
    assert node.camera.set == [(Control.GAIN, 3.0)]


async def test_what_the_camera_chooses_is_locked_during_a_burst(node: Node) -> None:
    await see_it_choose(node)
    node.camera.choose(5000.0)
    node.keeper.set_in_burst(True)
    await until(lambda: node.camera.set == [(Control.EXPOSURE, 5000.0)])
    node.camera.choose(6000.0)
    assert node.camera.states[Control.EXPOSURE].value == 5000.0
    node.keeper.set_in_burst(False)
    await until(lambda: node.camera.set[1:] == [(Control.EXPOSURE, None)])
    assert node.camera.states[Control.EXPOSURE].automatic
    assert node.changes == 0, "the grid stays where it is"


async def test_what_a_driver_may_not_tell_is_not_locked(node: Node) -> None:
    await settled(node)
    for is_taken in (True, False) * 3:
        node.keeper.set_in_burst(is_taken)
        await settled(node)
    assert node.camera.set == []
    assert node.camera.states[Control.EXPOSURE] == EXPOSURE


async def lock_exposure(node: Node) -> None:
    """Have a burst begin, and the exposure locked for it."""
    await see_it_choose(node)
    node.keeper.set_in_burst(True)
    await until(lambda: len(node.camera.set) == 1)
    assert not node.camera.states[Control.EXPOSURE].automatic


async def test_what_is_set_during_a_burst_stays_after_it(node: Node) -> None:
    await lock_exposure(node)
    await node.keeper.apply({Control.EXPOSURE: 2500.0})
    node.keeper.set_in_burst(False)
    await settled(node)
    assert node.camera.states[Control.EXPOSURE].value == 2500.0
    assert not node.camera.states[Control.EXPOSURE].automatic


async def test_what_a_burst_locked_is_let_go_once_the_camera_takes_orders_again(node: Node) -> None:
    await lock_exposure(node)
    node.camera.refuses_to_set = True
    node.keeper.set_in_burst(False)
    await settled(node)
    node.camera.refuses_to_set = False
    node.keeper.set_in_burst(True)
    node.keeper.set_in_burst(False)
    await until(lambda: node.camera.states[Control.EXPOSURE].automatic)


async def test_what_a_burst_locked_is_let_go_when_the_node_ends() -> None:
    made = Node()
    running = asyncio.create_task(made.keeper.run())
    await lock_exposure(made)
    running.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await running
    assert made.camera.states[Control.EXPOSURE].automatic


async def test_what_a_burst_locked_is_let_go_by_a_camera_that_was_opened_anew_and_kept_it(node: Node) -> None:
    await lock_exposure(node)
    node.keeper.set_in_burst(False)
    await node.keeper.restore()
    await until(lambda: node.camera.states[Control.EXPOSURE].automatic)
