"""What an operator is sent who watches a rig: changes, a sign of life, lines of the log, and previews."""

import asyncio
from collections.abc import AsyncIterator, Collection
from contextlib import asynccontextmanager
from typing import Any, cast

import pytest
from msgspec.structs import replace

from capture_app.common.errors import NetworkError
from capture_app.common.node_state import NodeState
from capture_app.node.leader.watchers import KEEPALIVE_S, Watcher
from capture_app.protocol.log import Log
from capture_app.protocol.messages import StatusAnswer
from capture_app.protocol.orders import LogAnswer, PreviewRequest, PreviewSeen
from capture_app.protocol.status import NodeStatus, Preview, RigStatus
from tests.facts import make_facts
from tests.unit.node.leader.fake_streams import FakeStream

pytestmark = pytest.mark.virtual


class Watched:
    """A rig and its previews as a watcher sees them; its clock runs, and its node was always just heard."""

    def __init__(self) -> None:
        self.log, self.stream = Log(), FakeStream()
        self.advice = "2 cameras ready"
        self.previews: dict[str, bytes] = {}
        self.wanted: list[PreviewRequest | None] = []
        self._looks = 0

    async def look_at_disk(self) -> None:
        pass

    def status(self, after: str) -> RigStatus:
        self._looks += 1
        node = NodeStatus(
            name="a",
            address="10.0.0.2:5",
            camera=make_facts(),
            last_seen_ns=self._looks,
            state=NodeState.READY,
        )
        return RigStatus(
            leader=f"leader{after}", advice=self.advice, now_ns=self._looks, period_ns=1, nodes=(node,)
        )

    def pictures(self, cameras: Collection[str] | None) -> list[Preview]:
        return [
            Preview(camera=name, leader_ns=1, width=1, height=1, jpeg=jpeg)
            for name, jpeg in self.previews.items()
            if cameras is None or name in cameras
        ]

    async def want(self, operator: object, request: PreviewRequest | None) -> None:
        self.wanted.append(request)

    def sent(self, kind: type[Any]) -> list[Any]:
        """Messages of a kind sent since the last call; all others are dropped."""
        return [message for message in self.stream.take() if isinstance(message, kind)]


@asynccontextmanager
async def watching() -> AsyncIterator[Watched]:
    watched = Watched()
    part: Any = watched
    serving = asyncio.create_task(Watcher(part.stream, part, watched.log, part).serve())
    yield watched
    watched.stream.say(None)
    await asyncio.wait([serving], timeout=5.0)
    assert serving.done()
    assert watched.wanted[-1] is None, "its cameras make no previews for nobody"


async def test_a_status_is_sent_when_it_changes_and_as_a_sign_of_life() -> None:
    async with watching() as watched:
        await asyncio.sleep(0.9 * KEEPALIVE_S)
        (first,) = watched.sent(StatusAnswer)
        assert (first.rig.leader, first.rig.now_ns, first.rig.nodes[0].last_seen_ns) == ("leader", 1, 1)
        await asyncio.sleep(0.2 * KEEPALIVE_S)
        assert len(watched.sent(StatusAnswer)) == 1
        watched.advice = "a is lost"
        await asyncio.sleep(0.21)
        (changed,) = watched.sent(StatusAnswer)
        assert changed.rig.advice == "a is lost"
        await asyncio.sleep(0.9 * KEEPALIVE_S)
        assert watched.sent(StatusAnswer) == [], "the last one is not as old yet"
        assert watched.stream.may_be_silent


async def test_changes_come_no_faster_than_anybody_reads() -> None:
    async with watching() as watched:
        for number in range(100):
            watched.advice = f"{number}"
            await asyncio.sleep(0.01)
        assert 9 <= len(watched.sent(StatusAnswer)) <= 11


async def test_each_line_of_the_log_is_sent_once() -> None:
    async with watching() as watched:
        watched.log.add("a joined")
        watched.log.add("b joined")
        await asyncio.sleep(0.3)
        lines = [line.text for answer in watched.sent(LogAnswer) for line in answer.lines]
        assert lines == ["a joined", "b joined"]
        watched.log.add("lost a")
        await asyncio.sleep(0.3)
        (answer,) = watched.sent(LogAnswer)
        assert [line.text for line in answer.lines] == ["lost a"]
        await asyncio.sleep(0.3)
        assert watched.sent(LogAnswer) == []


async def test_previews_are_sent_on_request_once_each_and_after_the_last_was_seen() -> None:
    request = PreviewRequest(width=64, fps=10, cameras=("a", "b"))
    async with watching() as watched:
        watched.previews = {"a": b"a0", "b": b"b0", "c": b"c0"}
        await asyncio.sleep(1.0)
        assert watched.sent(Preview) == []
        watched.stream.say(request)
        await asyncio.sleep(1.0)
        assert watched.wanted == [request]
        assert [(sent.camera, sent.jpeg) for sent in watched.sent(Preview)] == [("a", b""), ("b", b"")]
        assert watched.stream.payloads == [b"a0", b"b0"]
        watched.previews = {"a": b"a1", "b": b"b0"}
        watched.stream.say(PreviewSeen(camera="a"))
        await asyncio.sleep(1.0)
        assert watched.sent(Preview) == [], "b is on its way"
        watched.stream.say(PreviewSeen(camera="b"))
        await asyncio.sleep(1.0)
        assert [sent.camera for sent in watched.sent(Preview)] == ["a"], "b has no other one"
        assert watched.stream.payloads == [b"a0", b"b0", b"a1"]
        watched.stream.say(PreviewSeen(camera="a"))
        watched.stream.say(replace(request, fps=0))
        await watched.stream.is_read()
        watched.previews = {"a": b"a2"}
        await asyncio.sleep(1.0)
        assert watched.sent(Preview) == []


@pytest.mark.parametrize("fps", [0.5, 4, 20])
async def test_previews_come_at_the_requested_rate(fps: float) -> None:
    async with watching() as watched:
        watched.stream.say(PreviewRequest(width=64, fps=fps))
        await watched.stream.is_read()
        for number in range(400):
            watched.previews = {"a": b"%d" % number}
            watched.stream.say(PreviewSeen(camera="a"))
            await asyncio.sleep(0.01 * 5 / fps)
        # Within 20 intervals.
        assert 18 <= len(watched.sent(Preview)) <= 24


async def test_a_stream_that_breaks_off_ends_the_watch() -> None:
    watched = Watched()
    watched.stream.is_broken = True
    part = cast(Any, watched)
    with pytest.raises(NetworkError):
        await Watcher(part.stream, part, watched.log, part).serve()
    assert watched.wanted == [None]
