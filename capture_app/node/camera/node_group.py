"""Several cameras of one machine in one process: one node for each, none of which waits for another."""

import asyncio
from collections.abc import Mapping, Sequence
from typing import Any

from capture_app.cameras.specs import open_camera, parse_spec
from capture_app.common.clock import NodeClock
from capture_app.common.errors import BadInputError, CameraError, ungrouped_errors
from capture_app.common.names import check_name, free_name
from capture_app.node.camera.camera_node import CameraNode
from capture_app.node.camera.device_profiles import DeviceProfiles
from capture_app.node.camera.supervisor import NodeOptions
from capture_app.protocol.log import Log

RETRY_S = 5.0


async def run_nodes(nodes: Mapping[str, CameraNode], log: Log, *, retry_s: float = RETRY_S) -> None:
    """Run nodes side by side until cancelled; retry one whose camera fails while the others run.

    Raises CameraError where not one camera can be opened at the start, and any other error of a node.
    """
    failed: set[str] = set()

    async def keep(name: str) -> None:
        while True:
            failed.discard(name)
            try:
                await nodes[name].run()
                return
            except CameraError as error:
                failed.add(name)
                if len(failed) == len(nodes):
                    raise
                log.say(f"{name}: {error}; the node tries again while the others run")
            await asyncio.sleep(retry_s)

    with ungrouped_errors():
        async with asyncio.TaskGroup() as tasks:
            for name in nodes:
                tasks.create_task(keep(name))


def name_cameras(name: str, specs: Sequence[str]) -> dict[str, str]:
    """Return each camera's spec by its name: `name`, or NAME-DEVICE if there are several.

    Raises BadInputError for a spec that cannot be read or is given twice.
    """
    labels = [parse_spec(spec).label for spec in specs]
    if len(specs) == 1:
        return {name: specs[0]}
    named: dict[str, str] = {}
    for spec, label in zip(specs, labels, strict=True):
        if spec in named.values() and not spec.startswith("sim:"):
            raise BadInputError(f"the camera {spec} is given twice", hint="leave one out")
        named[free_name(check_name(f"{name}-{label}", "camera"), named)] = spec
    return named


def camera_node(name: str, spec: str, *, clock: NodeClock, **options: Any) -> CameraNode:
    """Return the node of one camera with this user's device profiles; the camera is opened when it runs.

    `options` are fields of `NodeOptions`.
    """
    return CameraNode(
        NodeOptions(
            name=name,
            open_camera=lambda: open_camera(spec, clock=clock, name=name),
            clock=clock,
            profiles=DeviceProfiles(),
            **options,
        )
    )
