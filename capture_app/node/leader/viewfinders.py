"""Streams over which nodes send previews and details to their leader while an operator watches."""

import asyncio
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any, TypeVar

from msgspec.structs import replace

from capture_app.common.bounds import Message
from capture_app.common.errors import IncompleteError, NetworkError
from capture_app.common.timeouts import NODE_ANSWER_TIMEOUT_S
from capture_app.net.channel import Channel
from capture_app.protocol.messages import NodeStream, ToLeader
from capture_app.protocol.orders import (
    NO_PREVIEWS,
    CameraHealth,
    ControlsAnswer,
    ControlsRequest,
    DetailRequest,
    PreviewRequest,
    PreviewSeen,
    RemoveCamera,
    SaveStamp,
    StampSaved,
    ToViewfinder,
)
from capture_app.protocol.status import NodeDetail, Preview

A = TypeVar("A", NodeDetail, ControlsAnswer, StampSaved)
MAX_PREVIEW_BYTES, MAX_PREVIEW_BYTES_PER_MACHINE = 4 << 20, 64 << 20
STORED = 4
"""Previews stored of each camera: as many as one may be behind the others."""


@dataclass(slots=True)
class _Stream:
    """A node's open viewfinder stream, and what was requested and received over it."""

    channel: Channel[ToLeader]
    health: CameraHealth = field(default_factory=CameraHealth)
    request: PreviewRequest = NO_PREVIEWS
    pictures: deque[Preview] = field(default_factory=lambda: deque(maxlen=STORED))
    """Its newest previews, of `MAX_PREVIEW_BYTES` together, newest last."""
    asked: "dict[type[Message], asyncio.Future[Any]]" = field(default_factory=dict)
    """Pending requests, by type of answer."""
    asking: asyncio.Lock = field(default_factory=asyncio.Lock)
    """One request at a time, because answers do not name their request."""

    arriving_bytes: int = 0
    """Size of the preview that is being read."""

    @property
    def bytes_in_memory(self) -> int:
        """Size of its previews, stored and arriving."""
        return self.arriving_bytes + sum(len(picture.jpeg) for picture in self.pictures)

    async def read(self, preview: Preview, of_others: int) -> None:
        """Read its next preview and store it, if an operator watches and it is not too large.

        `of_others` are the bytes in memory of its machine's other cameras.
        """
        size = self.channel.unread
        if not self.request.fps or size > MAX_PREVIEW_BYTES:
            return
        while self.bytes_in_memory + size > MAX_PREVIEW_BYTES:
            self.pictures.popleft()
        if of_others + self.bytes_in_memory + size <= MAX_PREVIEW_BYTES_PER_MACHINE:
            self.arriving_bytes = size
            jpeg = b"".join([chunk async for chunk in self.channel.payload()])
            self.arriving_bytes = 0
            self.pictures.append(replace(preview, jpeg=jpeg, completes=False))


@dataclass(slots=True)
class Viewfinders:
    """All nodes with an open viewfinder stream, and the previews that operators request."""

    _streams: dict[str, _Stream] = field(default_factory=dict)
    _requests: dict[object, PreviewRequest] = field(default_factory=dict)

    async def serve(self, channel: Channel[ToLeader], opened: NodeStream) -> None:
        """Process a node's messages until it closes its stream."""
        name = opened.camera
        channel.allow_silence()
        if name in self._streams:
            # A stream that the node has abandoned; it might never be closed otherwise.
            self._streams[name].channel.abort()
        stream = self._streams[name] = _Stream(channel)
        try:
            await self._ask(name)
            while (message := await channel.receive_header()) is not None:
                match message:
                    case CameraHealth():
                        stream.health = message
                    case Preview(camera=camera) if camera == name:
                        others = (other for other in self._streams.values() if other is not stream)
                        await stream.read(
                            message,
                            sum(
                                other.bytes_in_memory
                                for other in others
                                if other.channel.machine == channel.machine
                            ),
                        )
                        # Its node waits for this, also if nobody has watched since it sent the preview.
                        await channel.send(PreviewSeen(camera=name))
                    case NodeDetail() | ControlsAnswer() | StampSaved():
                        if (asked := stream.asked.pop(type(message), None)) is not None and not asked.done():
                            asked.set_result(message)
        finally:
            # The node's next stream may be noticed before the end of this one.
            if self._streams.get(name) is stream:
                del self._streams[name]
            for asked in stream.asked.values():
                if not asked.done():
                    asked.set_exception(_closed(name))
                    asked.exception()  # its caller may have disconnected

    @property
    def health(self) -> Mapping[str, CameraHealth]:
        """Current health of the cameras, by name."""
        return {name: stream.health for name, stream in self._streams.items()}

    async def want(self, operator: object, request: PreviewRequest | None) -> None:
        """Store which previews an operator requests (None: none), and request them from the nodes."""
        self._requests.pop(operator, None)
        if request is not None and request.fps > 0:
            self._requests[operator] = request
        for name in tuple(self._streams):
            await self._ask(name)

    def pictures(self, cameras: Collection[str] | None) -> list[Preview]:
        """Return what to show of `cameras` (None: of all), as `newest_instant` does."""
        return newest_instant(
            [
                tuple(stream.pictures)
                for name, stream in self._streams.items()
                if stream.pictures and (cameras is None or name in cameras)
            ]
        )

    async def ask(self, request: DetailRequest | ControlsRequest | SaveStamp, kind: type[A]) -> A:
        """Forward a request to its camera's node. Raises IncompleteError where it does not answer."""
        name, stream = request.camera, self._stream(request.camera)
        if isinstance(request, DetailRequest) and kind in stream.asked:
            return await _answer(stream, name, stream.asked[kind])  # all watching operators share an answer
        async with stream.asking:
            answer: asyncio.Future[A] = asyncio.get_running_loop().create_future()
            stream.asked[kind] = answer
            await _send(stream.channel, request)
            return await _answer(stream, name, answer)

    async def put_off(self, camera: str) -> None:
        """End a phone's node. Raises IncompleteError where it has no stream open."""
        await _send(self._stream(camera).channel, RemoveCamera(name=camera))

    def _stream(self, name: str) -> _Stream:
        if name not in self._streams:
            raise _closed(name)
        return self._streams[name]

    async def _ask(self, name: str) -> None:
        """Send a node the combined preview request of all operators, if it has changed."""
        if (stream := self._streams.get(name)) is None:
            return
        requests = [w for w in self._requests.values() if w.cameras is None or name in w.cameras]
        requests = requests or [NO_PREVIEWS]
        request = PreviewRequest(width=max(w.width for w in requests), fps=max(w.fps for w in requests))
        if request != stream.request:
            stream.request = request
            if not request.fps:
                stream.pictures.clear()
            await _send(stream.channel, request)


def newest_instant(stored: Sequence[Sequence[Preview]]) -> list[Preview]:
    """Return the previews of the newest instant that cameras have in common, from each one's newest previews.

    The last of them completes it. Before them comes the newest preview of each camera that has no instant, or
    none as new as the `STORED` ones of another: it does not hold up the others. If all cameras skip different
    instants, they are all shown so.
    """
    shown = [
        {preview.instant_ns: preview for preview in previews if preview.instant_ns is not None}
        for previews in stored
    ]
    since_ns = max((min(by_instant) for by_instant in shown if len(by_instant) == STORED), default=-inf)
    together = [by_instant for by_instant in shown if by_instant and max(by_instant) >= since_ns]
    common = set[int].intersection(*map(set, together)) if together else set()
    if not common and all(len(by_instant) == STORED for by_instant in together):
        together = []
    single = [
        previews[-1] for previews, by_instant in zip(stored, shown, strict=True) if by_instant not in together
    ]
    if not common:
        return single
    *others, last = (by_instant[max(common)] for by_instant in together)
    return [*single, *others, replace(last, completes=True)]


async def _answer(stream: _Stream, name: str, answer: "asyncio.Future[A]") -> A:
    """Wait for an answer that others may await too. Raises IncompleteError where a node does not answer."""
    try:
        async with asyncio.timeout(NODE_ANSWER_TIMEOUT_S):
            return await asyncio.shield(answer)
    except TimeoutError as error:
        # A late answer would be taken for the answer to the next request.
        stream.channel.abort()
        raise IncompleteError(f"{name} does not answer", hint="it may be busy; try again") from error


async def _send(channel: Channel[ToLeader], message: ToViewfinder) -> None:
    try:
        await channel.send(message)
    except NetworkError:
        # The server of that stream notices that it has broken off.
        channel.abort()


def _closed(name: str) -> IncompleteError:
    return IncompleteError(
        f"{name} has no open stream", hint="check that it is connected: capture-app status"
    )
