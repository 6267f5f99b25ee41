"""Requests to a running leader, as commands and the screen make them.

Exposure, gain, white balance and focus of a rig's cameras: shown, set, and measured on one for all.
"""

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from typing import TypeVar

from msgspec.structs import replace

from capture_app.camera_facts import MICROSECONDS, TIMES, CameraControls, Control, ControlValue
from capture_app.errors import BadInputError, IncompleteError
from capture_app.net.address import Address
from capture_app.net.channel import connect
from capture_app.node.asking import ANSWER_TIMEOUT_S, ask, receive_answer
from capture_app.node.wire import messages, operating
from capture_app.node.wire.message import Message
from capture_app.node.wire.operating import ExposeAppPhones
from capture_app.node.wire.status import BurstStatus, NodeStatus, RigStatus
from capture_app.sync.wire.messages import WITHOUT_CAMERA, NodeState

ORDER_TIMEOUT_S = 40.0
"""A camera that is started has to be opened first."""

A = TypeVar("A", bound=Message)


async def ask_status(leader: Address) -> RigStatus:
    """Return the status of the rig of a running leader, with all its nodes. Raises NetworkError."""
    nodes: list[NodeStatus] = []
    async with await connect(leader, messages.FromLeader) as channel:
        while True:
            request = messages.StatusRequest(after=nodes[-1].name if nodes else "")
            rig = (await ask(channel, request, messages.StatusAnswer)).rig
            nodes += rig.nodes
            if not rig.further or not rig.nodes:
                return replace(rig, nodes=tuple(nodes))


async def ask_leader(leader: Address, request: Message, kind: type[A]) -> A:
    """Return a leader's answer to a request, of that kind. Raises NetworkError, and the leader's errors."""
    timeout_s = ORDER_TIMEOUT_S if isinstance(request, operating.Order) else ANSWER_TIMEOUT_S
    async with await connect(leader, messages.FromLeader) as channel:
        return await ask(channel, request, kind, timeout_s)


async def ask_controls(
    leader: Address, camera: str, wanted: Mapping[Control, ControlValue]
) -> CameraControls:
    """Set what is wanted of a camera's controls, nothing if empty; return them all as they stand then.

    Raises NetworkError, and the leader's own errors.
    """
    request = operating.ControlsRequest(camera=camera, wanted=dict(wanted))
    return (await ask_leader(leader, request, operating.ControlsAnswer)).state


async def give_order(leader: Address, order: operating.Order) -> tuple[str, ...]:
    """Return when the leader has done it, with the names of cameras that it started.

    Raises NetworkError, and the leader's own errors.
    """
    return (await ask_leader(leader, order, operating.Done)).names


async def ask_burst(leader: Address, request: messages.BurstRequest) -> AsyncIterator[BurstStatus]:
    """Order a burst and yield its progress until it is done.

    Raises NetworkError, and the leader's own errors.
    """
    async with await connect(leader, messages.FromLeader) as channel:
        await channel.send(request)
        while True:
            # The leader tells how far it is once a second at least: silence means that it is gone.
            answer = await receive_answer(channel)
            if isinstance(answer, messages.BurstAnswer):
                yield answer.burst
                if answer.burst.done:
                    return


ISO_OF_GAIN_1 = 100


CamerasControls = dict[str, CameraControls]
"""By camera of the rig its controls as they stand, with what could not be done of what was asked."""


async def read_all(leader: Address) -> CamerasControls:
    """Return the controls of all cameras that are here. Raises NetworkError."""
    return await _each(leader, present_cameras(await ask_status(leader)), {})


async def set_cameras(
    leader: Address, wanted: Mapping[Control, ControlValue], cameras: Sequence[str] = ()
) -> CamerasControls:
    """Set controls of these cameras, or of all that are here.

    Raises BadInputError for a camera that is not here, NetworkError.
    """
    here = present_cameras(await ask_status(leader))
    if unknown := sorted({*cameras} - {*here}):
        raise BadInputError(f"no camera {', '.join(unknown)} is here", hint="capture-app status lists them")
    return await _each(leader, cameras or here, wanted)


async def match_cameras(
    leader: Address, source: str, controls: Sequence[Control] = tuple(Control)
) -> CamerasControls:
    """Hold what one camera has chosen, and set it on all others that can; the first is that camera.

    A value goes to those whose unit is the same: a gain in steps of one model means nothing to another.
    Raises BadInputError where that camera is not here, NetworkError.
    """
    rig = await ask_status(leader)
    first = (await set_cameras(leader, dict.fromkeys(controls, "hold"), [source]))[source]
    others = [name for name in present_cameras(rig) if name != source]
    rest = await asyncio.gather(*(_set_like(leader, name, first, controls) for name in others))
    alike = {source: first, **dict(zip(others, rest, strict=True))}
    return alike | await _set_app_phones(leader, rig, first)


def present_cameras(rig: RigStatus) -> list[str]:
    """The names of the cameras that are here."""
    return [
        node.name
        for node in rig.nodes
        if node.camera.kind not in WITHOUT_CAMERA and node.state is not NodeState.LOST
    ]


async def _each(
    leader: Address, cameras: Sequence[str], wanted: Mapping[Control, ControlValue]
) -> CamerasControls:
    states = await asyncio.gather(*(_ask_camera(leader, name, wanted) for name in cameras))
    return dict(zip(cameras, states, strict=True))


async def _ask_camera(leader: Address, name: str, wanted: Mapping[Control, ControlValue]) -> CameraControls:
    try:
        return await ask_controls(leader, name, wanted)
    except IncompleteError as error:
        return CameraControls(problems=dict.fromkeys(wanted, error.what))


async def _set_like(
    leader: Address, name: str, like: CameraControls, controls: Sequence[Control]
) -> CameraControls:
    own = await _ask_camera(leader, name, {})
    wanted: dict[Control, ControlValue] = {}
    problems: dict[Control, str] = {}
    for control in controls:
        measured, mine = like.state(control), own.state(control)
        if measured is None or measured.value is None:
            continue
        if mine is None:
            problems[control] = f"it has no control of its {control}"
        elif mine.unit != measured.unit:
            problems[control] = f"its {control} is in {mine.unit}, and was measured in {measured.unit}"
        else:
            wanted[control] = measured.value
    done = await _ask_camera(leader, name, wanted)
    return CameraControls(controls=done.controls, problems={**problems, **done.problems})


async def _set_app_phones(leader: Address, rig: RigStatus, like: CameraControls) -> CamerasControls:
    """Tell phones with the app, which answer nothing; their gain is an ISO, of which 100 is taken for 1."""
    phones = [phone.name for phone in rig.app_phones if phone.state != "lost"]
    if not phones:
        return {}
    exposure, gain = like.state(Control.EXPOSURE), like.state(Control.GAIN)
    values = (None if exposure is None else exposure.value, None if gain is None else gain.value)
    told = "it was told, and answers nothing"
    if exposure is not None and gain is not None and None not in values and gain.unit == TIMES:
        assert exposure.unit == MICROSECONDS, "the unit of every exposure"
        order = ExposeAppPhones(
            exposure_ns=round((exposure.value or 0) * 1000), iso=round((gain.value or 0) * ISO_OF_GAIN_1)
        )
        await give_order(leader, order)
        problems = {Control.EXPOSURE: told, Control.GAIN: told}
    else:
        problems = {Control.EXPOSURE: "it takes an exposure with a gain only, which was not measured in ×"}
    return {name: CameraControls(problems=problems) for name in phones}
