"""A screen's connection to a leader: updates in, orders out; it is opened again whenever it is lost."""

import asyncio
import shlex
from collections.abc import AsyncGenerator, AsyncIterator
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from capture_app.errors import NetworkError, SimulshotError, UnknownMachineError
from capture_app.net.address import Address, parse_address
from capture_app.net.channel import Channel, connect
from capture_app.node.asking import receive_answer
from capture_app.node.requests import A, CamerasControls, ask_burst, ask_leader, give_order, match_cameras
from capture_app.node.wire import messages, operating
from capture_app.node.wire.message import Message
from capture_app.node.wire.status import BurstStatus, NewsLine, Preview, RigStatus


class LinkLost(Struct, frozen=True):
    """The connection to the leader is lost, or was never there, and is being tried again."""

    reason: str
    """One sentence, with what to do about it."""


Update = RigStatus | NewsLine | Preview | LinkLost


SILENCE_S = 10.0
"""A leader sends its status more often than this, changed or not."""
RETRY_S = (0.2, 0.5, 1.0, 2.0)


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
        self._wish: operating.PreviewsWanted | None = None
        self._news_ns = 0
        self._rig: RigStatus | None = None
        """As it was told last."""

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
                    await channel.send(operating.WatchRequest())
                    if self._wish is not None:
                        await channel.send(self._wish)
                    while True:
                        message = await receive_answer(channel, SILENCE_S)
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
        self._wish = operating.PreviewsWanted(cameras=cameras, width=width, fps=fps)
        if self._channel is not None:
            try:
                await self._channel.send(self._wish)
            except NetworkError:
                self._channel.abort()  # whoever reads it opens it again, and tells this wish

    def burst(self, request: messages.BurstRequest) -> AsyncIterator[BurstStatus]:
        """Take a burst and yield its progress until it is done; leaving it early does not cancel it."""
        return ask_burst(self.leader, request)

    async def order(self, order: operating.Order) -> None:
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
            case operating.NewsAnswer():
                for line in message.lines:
                    # A connection that is opened again tells all of them again.
                    if line.unix_ns > self._news_ns:
                        self._news_ns = line.unix_ns
                        yield line
            case Preview():
                jpeg = b"".join([chunk async for chunk in channel.payload()])
                await channel.send(operating.PreviewSeen(camera=message.camera))
                yield replace(message, jpeg=jpeg)
            case _:
                pass
