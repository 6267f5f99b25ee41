"""Several cameras in one process: none waits for another, and what ends them all."""

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, cast

import pytest

from capture_app.common.errors import BadInputError, CameraError, SimulshotError
from capture_app.node.camera.camera_node import CameraNode
from capture_app.node.camera.node_group import run_nodes
from capture_app.protocol.log import Log
from tests.waiting import until

pytestmark = pytest.mark.virtual


class ScriptedNode:
    """A node that raises what its script says, one try after the other, and then runs."""

    def __init__(self, *errors: SimulshotError) -> None:
        self.errors = list(errors)
        self.runs = 0

    async def run(self) -> None:
        if self.errors:
            raise self.errors.pop(0)
        self.runs += 1
        await asyncio.Event().wait()


def group_of(
    nodes: Mapping[str, ScriptedNode], said: list[str], retry_s: float = 60.0
) -> Coroutine[Any, Any, None]:
    return run_nodes(cast(Mapping[str, CameraNode], nodes), Log(said.append), retry_s=retry_s)


async def run_until(group: Coroutine[Any, Any, None], holds: Callable[[], object]) -> None:
    """Run a group until something holds, and end it."""
    task = asyncio.create_task(group)
    await until(lambda: task.done() or holds())
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task


async def test_a_missing_camera_is_tried_again_while_others_run() -> None:
    here, late, said = ScriptedNode(), ScriptedNode(*[CameraError("no camera")] * 2), list[str]()
    group = group_of({"here": here, "late": late}, said, retry_s=0.01)
    await run_until(group, lambda: late.runs)
    assert (here.runs, late.runs) == (1, 1)
    assert said == ["late: no camera; the node tries again while the others run"] * 2


async def test_without_any_camera_it_ends_with_the_error() -> None:
    missing = {name: ScriptedNode(CameraError(f"no {name}")) for name in ("a", "b")}
    with pytest.raises(CameraError, match="no b"):
        await group_of(missing, [])
    with pytest.raises(CameraError, match="no c"):
        await group_of({"c": ScriptedNode(CameraError("no c"))}, [])


async def test_another_error_ends_all_of_them() -> None:
    nodes = {"a": ScriptedNode(), "b": ScriptedNode(BadInputError("fps=0"))}
    with pytest.raises(BadInputError, match="fps=0"):
        await group_of(nodes, [])
