"""What operators ask of a running leader: once, or over a screen's link, which tells what changes.

The link is opened again whenever it is lost. Exposure, gain, white balance and focus of a rig's cameras are
shown, set, and measured on one for all.
"""

import asyncio
import shlex
from collections.abc import AsyncGenerator, AsyncIterator, Mapping, Sequence
from typing import Any, TypeVar

from msgspec import Struct
from msgspec.structs import replace

from capture_app.common.address import Address, parse_address
from capture_app.common.camera_facts import MICROSECONDS, TIMES, CameraControls, Control, ControlValue
from capture_app.common.errors import (
    BadInputError,
    IncompleteError,
    NetworkError,
    SimulshotError,
    UnknownMachineError,
)
from capture_app.common.node_state import WITHOUT_CAMERA, NodeState
from capture_app.common.timeouts import ANSWER_TIMEOUT_S, ORDER_TIMEOUT_S, STATUS_TIMEOUT_S
from capture_app.net.asking import ask, receive_answer
from capture_app.net.channel import Channel, connect
from capture_app.protocol import messages, orders
from capture_app.protocol.message import Message
from capture_app.protocol.orders import ExposeAppPhones
from capture_app.protocol.status import BurstStatus, NewsLine, NodeStatus, Preview, RigStatus

A = TypeVar("A", bound=Message)
ISO_OF_GAIN_1 = 100
RETRY_S = (0.2, 0.5, 1.0, 2.0)


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
    timeout_s = ORDER_TIMEOUT_S if isinstance(request, orders.Order) else ANSWER_TIMEOUT_S
    async with await connect(leader, messages.FromLeader) as channel:
        return await ask(channel, request, kind, timeout_s)


async def ask_controls(
    leader: Address, camera: str, wanted: Mapping[Control, ControlValue]
) -> CameraControls:
    """Set what is wanted of a camera's controls, nothing if empty; return them all as they stand then.

    Raises NetworkError, and the leader's own errors.
    """
    request = orders.ControlsRequest(camera=camera, wanted=dict(wanted))
    return (await ask_leader(leader, request, orders.ControlsAnswer)).state


async def give_order(leader: Address, order: orders.Order) -> tuple[str, ...]:
    """Return when the leader has done it, with the names of cameras that it started.

    Raises NetworkError, and the leader's own errors.
    """
    return (await ask_leader(leader, order, orders.Done)).names


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


class LinkLost(Struct, frozen=True):
    """The connection to the leader is lost, or was never there, and is being tried again."""

    reason: str
    """One sentence, with what to do about it."""


Update = RigStatus | NewsLine | Preview | LinkLost


def start_again(rig: RigStatus) -> str:
    """What to type so that a rig whose leader is gone is led again."""
    if rig.relay is not None:
        return "is its relay still there?"
    port, folder = parse_address(rig.leader).port, shlex.quote(rig.sessions_folder or "sessions")
    line = f"capture-app rig start --port {port} --sessions {folder}"
    return f"if it has ended, start it again on its machine: {line}"


class RigLink:
    """A leader and its cameras. All but `updates` raise SimulshotError: the leader's own, or NetworkError."""

    def __init__(self, leader: Address) -> None:
        self.leader = leader
        """Where the leader is reached from here; `RigStatus.leader` is what other machines are told."""
        self._channel: Channel[Any] | None = None
        self._wish: orders.PreviewsWanted | None = None
        self._news_ns = 0
        self._rig: RigStatus | None = None
        """As it was told last."""

    def another(self) -> "RigLink":
        """Return a second link to the same leader, for another reader of updates."""
        return RigLink(self.leader)

    async def updates(self) -> AsyncGenerator[Update, None]:
        """Yield what changes, for ever: for one reader at a time.

        At first, and after each `LinkLost`, come the status and the latest news that were not yielded before;
        then a `RigStatus` whenever it has changed, at most ten a second. A lost connection is opened again
        and again; the first status after `LinkLost` says that it is back.
        """
        failures = 0
        while True:
            try:
                async with await connect(self.leader, messages.FromLeader) as channel:
                    self._channel = channel
                    await channel.send(orders.WatchRequest())
                    if self._wish is not None:
                        await channel.send(self._wish)
                    while True:
                        message = await receive_answer(channel, STATUS_TIMEOUT_S)
                        failures = 0
                        async for update in self._read(channel, message):
                            yield update
            except SimulshotError as error:
                if not failures:
                    rig = None if isinstance(error, UnknownMachineError) else self._rig
                    yield LinkLost(str(error) if rig is None else f"{error.what}; {start_again(rig)}")
            finally:
                self._channel = None
            await asyncio.sleep(RETRY_S[min(failures, len(RETRY_S) - 1)])
            failures += 1

    async def want_previews(self, *, cameras: tuple[str, ...] | None, width: int, fps: float) -> None:
        """Ask for small pictures of these cameras among the updates: None for all, 0 `fps` for none.

        At most `fps` a second of each, fewer where the link or the screen is slow, none while a burst is
        selected or sent. Kept over reconnections; does not wait for an answer.
        """
        self._wish = orders.PreviewsWanted(cameras=cameras, width=width, fps=fps)
        if self._channel is not None:
            try:
                await self._channel.send(self._wish)
            except NetworkError:
                self._channel.abort()  # whoever reads it opens it again, and tells this wish

    def burst(self, request: messages.BurstRequest) -> AsyncIterator[BurstStatus]:
        """Take a burst and yield its progress until it is done; leaving it early does not cancel it."""
        return ask_burst(self.leader, request)

    async def order(self, order: orders.Order) -> None:
        """Return when the leader has done it."""
        await give_order(self.leader, order)

    async def ask(self, request: Message, kind: type[A]) -> A:
        """Return the leader's answer of that kind: once or twice a second, not more."""
        return await ask_leader(self.leader, request, kind)

    async def match_cameras(self, source: str) -> CamerasControls:
        """Hold exposure, gain, white balance and focus of one camera, and set them on all others that can."""
        return await match_cameras(self.leader, source)

    async def _read(self, channel: Channel[Any], message: messages.FromLeader) -> AsyncIterator[Update]:
        match message:
            case messages.StatusAnswer():
                self._rig = message.rig
                yield message.rig
            case orders.NewsAnswer():
                for line in message.lines:
                    # A connection that is opened again tells all of them again.
                    if line.unix_ns > self._news_ns:
                        self._news_ns = line.unix_ns
                        yield line
            case Preview():
                jpeg = b"".join([chunk async for chunk in channel.payload()])
                await channel.send(orders.PreviewSeen(camera=message.camera))
                yield replace(message, jpeg=jpeg)
            case _:
                pass
