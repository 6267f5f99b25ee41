"""Requests of operators to a running leader: single ones, or over a screen's link, which yields changes.

The link is reopened whenever it is lost. Exposure, gain, white balance and focus of a rig's cameras are
shown, set, and measured on one camera for all.
"""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Mapping, Sequence
from typing import Any, TypeVar

from msgspec import Struct
from msgspec.structs import replace

from capture_app.common.address import Address, parse_address
from capture_app.common.bounds import Message
from capture_app.common.camera_facts import CameraControls, Control, ControlValue
from capture_app.common.errors import (
    BadInputError,
    IncompleteError,
    NetworkError,
    SimulshotError,
    UnknownMachineError,
)
from capture_app.common.names import is_name, label_key
from capture_app.common.node_state import NodeState
from capture_app.common.text import command_line
from capture_app.common.timeouts import ANSWER_TIMEOUT_S, ORDER_TIMEOUT_S, STATUS_TIMEOUT_S
from capture_app.net.asking import ask, ask_all_nodes, receive_answer
from capture_app.net.channel import Channel, connect
from capture_app.protocol import messages, orders
from capture_app.protocol.status import BurstStatus, LogLine, Preview, RigStatus
from capture_app.rig.rig_time import PlacedMark, place_mark

A = TypeVar("A", bound=Message)
RETRY_S = (0.2, 0.5, 1.0, 2.0)


async def ask_status(leader: Address) -> RigStatus:
    """Return the status of a running leader's rig, with all its nodes. Raises NetworkError."""
    async with await connect(leader, messages.FromLeader) as channel:
        return await ask_all_nodes(channel)


async def ask_leader(leader: Address, request: Message, kind: type[A]) -> A:
    """Return a leader's answer to a request, of type `kind`. Raises NetworkError, and the leader's errors."""
    timeout_s = ORDER_TIMEOUT_S if isinstance(request, orders.Order) else ANSWER_TIMEOUT_S
    async with await connect(leader, messages.FromLeader) as channel:
        return await ask(channel, request, kind, timeout_s)


async def give_order(leader: Address, order: orders.Order) -> tuple[str, ...]:
    """Give an order; return the names of cameras that it started, once it is carried out.

    Raises NetworkError, and the leader's own errors.
    """
    return (await ask_leader(leader, order, orders.Done)).names


CamerasControls = dict[str, CameraControls]
"""Current controls of each camera of the rig, with the requests that failed."""


async def set_cameras(
    leader: Address, rig: RigStatus, values: Mapping[Control, ControlValue], cameras: Sequence[str] = ()
) -> CamerasControls:
    """Set the `values` controls of these cameras, or of all present ones; return the state of all controls.

    Raises BadInputError for a camera that is not here, NetworkError.
    """
    here, cameras = present_cameras(rig), [camera_named(rig, text) for text in cameras]
    if unknown := sorted({*cameras} - {*here}):
        raise BadInputError(
            f"the rig has no camera {', '.join(unknown)}", hint="list them with: capture-app status"
        )
    names = cameras or here
    states = await asyncio.gather(*(_ask_camera(leader, name, values) for name in names))
    return dict(zip(names, states, strict=True))


async def match_cameras(
    leader: Address, rig: RigStatus, source: str, controls: Sequence[Control] = tuple(Control)
) -> CamerasControls:
    """Hold the values that one camera has chosen, and set them on all others that can.

    Return the controls of each camera, that one first. A value applies only to cameras with the same unit, as
    gain steps differ between models. Raises BadInputError if the rig has no such camera, and NetworkError.
    """
    source = camera_named(rig, source)
    first = (await set_cameras(leader, rig, dict.fromkeys(controls, "hold"), [source]))[source]
    others = [name for name in present_cameras(rig) if name != source]
    rest = await asyncio.gather(*(_set_like(leader, name, first, controls) for name in others))
    return {
        source: first,
        **dict(zip(others, rest, strict=True)),
    }


def camera_named(rig: RigStatus, text: str) -> str:
    """Return the name of the node that a person means, by what people call it or its name.

    It is `text` if there is none. Raises BadInputError where that is not a name.
    """
    titles, key = rig.titles, label_key(text)
    # What people call one goes before another's name.
    both = (*titles.items(), *zip(titles, titles, strict=True))
    named = next((name for name, called in both if label_key(called) == key), text)
    if not is_name(named):
        raise BadInputError(f"the rig has no camera {text}", hint=f"it has {', '.join(titles.values())}")
    return named


def present_cameras(rig: RigStatus) -> list[str]:
    """Return the names of the present cameras."""
    return [node.name for node in rig.cameras if node.state is not NodeState.LOST]


async def _ask_camera(leader: Address, name: str, values: Mapping[Control, ControlValue]) -> CameraControls:
    request = orders.ControlsRequest(camera=name, values=dict(values))
    try:
        return (await ask_leader(leader, request, orders.ControlsAnswer)).state
    except IncompleteError as error:
        return CameraControls(problems=dict.fromkeys(values, error.what))


async def _set_like(
    leader: Address, name: str, like: CameraControls, controls: Sequence[Control]
) -> CameraControls:
    own = await _ask_camera(leader, name, {})
    values: dict[Control, ControlValue] = {}
    problems: dict[Control, str] = {}
    for measured in like.controls:
        control, mine = measured.control, own.state(measured.control)
        if control not in controls or measured.value is None:
            continue
        if mine is None:
            problems[control] = f"its {control} cannot be controlled"
        elif mine.unit != measured.unit:
            problems[control] = f"its {control} is in {mine.unit}, but was measured in {measured.unit}"
        else:
            values[control] = measured.value
    done = await _ask_camera(leader, name, values)
    return CameraControls(controls=done.controls, problems={**problems, **done.problems})


class LinkLost(Struct, frozen=True):
    """The connection to the leader is lost, or was never made, and is being retried."""

    reason: str
    """One sentence, with a remedy."""


Update = RigStatus | LogLine | Preview | LinkLost


def start_again(rig: RigStatus) -> str:
    """Return how to restart a rig whose leader is lost."""
    if rig.relay is not None:
        return "is its relay still there?"
    port, folder = parse_address(rig.leader).port, command_line(rig.sessions_folder or "sessions")
    return (
        "if it has ended, start it again on its machine:"
        f" capture-app rig start --port {port} --sessions {folder}"
    )


class RigLink:
    """A leader and its cameras. All but `updates` raise SimulshotError: the leader's own, or NetworkError."""

    def __init__(self, leader: Address) -> None:
        self.leader = leader
        """The leader's address from here; `RigStatus.leader` is the address for other machines."""
        self._channel: Channel[Any] | None = None
        self._request: orders.PreviewRequest | None = None
        self._log_ns = 0
        self._rig: RigStatus | None = None
        """The latest status received."""

    def another(self) -> "RigLink":
        """Return a second link to the same leader, for another reader of updates."""
        return RigLink(self.leader)

    async def mark(self, text: str) -> PlacedMark:
        """Note an event in the take under way, at the time of this call."""
        return await place_mark(self.leader, text)

    async def updates(self) -> AsyncGenerator[Update, None]:
        """Yield the rig's changes, forever; for one reader at a time.

        At first and after each `LinkLost` come the status and the latest log lines that were not yielded
        before. Then a `RigStatus` follows whenever it has changed, at most ten a second. A lost connection is
        reopened repeatedly; the first status after `LinkLost` means that the connection is back.
        """
        failures = 0
        while True:
            try:
                async with await connect(self.leader, messages.FromLeader) as channel:
                    self._channel = channel
                    await channel.send(orders.WatchRequest())
                    if self._request is not None:
                        await channel.send(self._request)
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
        """Request previews of these cameras among the updates: None for all, `fps` 0 for none.

        At most `fps` a second of each, fewer where the link or the screen is slow, none while a burst is
        selected or sent. The request persists over reconnections; this does not wait for an answer.
        """
        self._request = orders.PreviewRequest(cameras=cameras, width=width, fps=fps)
        if self._channel is not None:
            try:
                await self._channel.send(self._request)
            except NetworkError:
                self._channel.abort()  # the reader of updates reconnects, and sends this request

    async def burst(self, request: messages.BurstRequest) -> AsyncIterator[BurstStatus]:
        """Take a burst and yield its progress until it is done; leaving it early does not cancel it."""
        async with await connect(self.leader, messages.FromLeader) as channel:
            await channel.send(request)
            while True:
                # The leader reports progress at least once a second, so silence means that it is lost.
                answer = await receive_answer(channel)
                if isinstance(answer, messages.BurstAnswer):
                    yield answer.burst
                    if answer.burst.done:
                        return

    async def order(self, order: orders.Order) -> None:
        """Give an order, and return once it is carried out."""
        await give_order(self.leader, order)

    async def ask(self, request: Message, kind: type[A]) -> A:
        """Return the leader's answer of type `kind`; call it at most once or twice a second."""
        return await ask_leader(self.leader, request, kind)

    async def match_cameras(self, source: str) -> CamerasControls:
        """Hold exposure, gain, white balance and focus of one camera, and set them on all others that can."""
        return await match_cameras(self.leader, await ask_status(self.leader), source)

    async def set_camera(self, camera: str, values: Mapping[Control, ControlValue]) -> CamerasControls:
        """Set controls of one camera, and return the state of all of them."""
        return await set_cameras(self.leader, await ask_status(self.leader), values, [camera])

    async def _read(self, channel: Channel[Any], message: messages.FromLeader) -> AsyncIterator[Update]:
        match message:
            case messages.StatusAnswer():
                self._rig = message.rig
                yield message.rig
            case orders.LogAnswer():
                for line in message.lines:
                    # A reopened connection sends all of them again.
                    if line.unix_ns > self._log_ns:
                        self._log_ns = line.unix_ns
                        yield line
            case Preview():
                jpeg = b"".join([chunk async for chunk in channel.payload()])
                await channel.send(orders.PreviewSeen(camera=message.camera))
                yield replace(message, jpeg=jpeg)
