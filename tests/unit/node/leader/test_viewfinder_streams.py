"""Streams of cameras that show previews: what is requested of each, stored of each, and dropped."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any, cast

import pytest
from msgspec.structs import replace

from capture_app.common.camera_facts import CameraControls
from capture_app.common.errors import IncompleteError
from capture_app.common.tasks import end
from capture_app.node.leader import viewfinders as module
from capture_app.node.leader.viewfinders import STORED, Viewfinders
from capture_app.protocol.messages import NodeStream
from capture_app.protocol.orders import (
    CameraHealth,
    ControlsAnswer,
    ControlsRequest,
    DetailRequest,
    PreviewRequest,
    PreviewSeen,
    RemoveCamera,
)
from capture_app.protocol.status import NodeDetail, Preview
from tests.unit.node.leader.fake_streams import FakeStream

pytestmark = pytest.mark.virtual

ALL = PreviewRequest(width=64, fps=5)
EMPTY = CameraControls()
NONE = PreviewRequest(width=16, fps=0)


def preview(camera: str, instant: int) -> Preview:
    return Preview(camera=camera, leader_ns=instant, width=1, height=1)


def shown(finders: Viewfinders, *cameras: str) -> dict[str, bytes]:
    """The newest preview of each camera."""
    return {picture.camera: picture.jpeg for picture in finders.pictures(cameras or None)}


Open = Callable[..., FakeStream]


@asynccontextmanager
async def opening(finders: Viewfinders) -> AsyncIterator[Open]:
    """A function that opens a camera's stream, all of which are closed when the block ends."""
    tasks = []

    def open_stream(name: str, machine: str = "machine", stream: FakeStream | None = None) -> FakeStream:
        stream = stream or FakeStream(machine)
        opened = NodeStream(camera=name, instance=1, shows=True)
        tasks.append(asyncio.create_task(finders.serve(cast(Any, stream), opened)))
        return stream

    yield open_stream
    await end(*tasks)


async def test_each_camera_is_asked_once_for_the_most_that_any_operator_wants_of_it() -> None:
    finders = Viewfinders()
    async with opening(finders) as open_stream:
        await finders.want("desk", PreviewRequest(width=64, fps=5))
        a, b = open_stream("a"), open_stream("b")
        await asyncio.sleep(0.1)
        assert (a.may_be_silent, a.take(), b.take()) == (True, [ALL], [ALL])
        await finders.want("tablet", PreviewRequest(width=640, fps=1, cameras=("b",)))
        assert (a.take(), b.take()) == ([], [PreviewRequest(width=640, fps=5)])
        await finders.want("desk", None)
        assert (a.take(), b.take()) == ([NONE], [PreviewRequest(width=640, fps=1)])
        await finders.want("tablet", PreviewRequest(width=640, fps=0))
        assert (a.take(), b.take()) == ([], [NONE])


async def test_the_newest_previews_are_stored_while_an_operator_watches() -> None:
    finders = Viewfinders()
    async with opening(finders) as open_stream:
        a, b = open_stream("a"), open_stream("b")
        a.say(preview("a", 0), b"nobody watches")
        await a.is_read()
        assert (a.take(), shown(finders)) == ([PreviewSeen(camera="a")], {})
        await finders.want("desk", ALL)
        for number in range(STORED + 3):
            a.say(preview("a", number), b"%d" % number)
        b.say(preview("b", 1), b"b")
        b.say(preview("a", 9), b"forged")
        await a.is_read()
        await b.is_read()
        assert a.take() == [ALL, *[PreviewSeen(camera="a")] * (STORED + 3)]
        assert b.take() == [ALL, PreviewSeen(camera="b")], "of another camera it may send none"
        assert shown(finders) == {"a": b"6", "b": b"b"}
        assert shown(finders, "b") == {"b": b"b"}
        await finders.want("desk", PreviewRequest(width=640, fps=5))
        assert shown(finders) == {"a": b"6", "b": b"b"}
        await finders.want("desk", None)
        await finders.want("desk", ALL)
        assert shown(finders) == {}, "they would be old"


async def test_a_camera_does_not_say_that_an_instant_is_complete() -> None:
    finders = Viewfinders()
    await finders.want("desk", ALL)
    async with opening(finders) as open_stream:
        a = open_stream("a")
        a.say(replace(preview("a", 1), completes=True), b"a")
        await a.is_read()
        assert [picture.completes for picture in finders.pictures(None)] == [False]


async def test_a_camera_that_leaves_while_others_are_asked_disturbs_no_operator() -> None:
    class Slow(FakeStream):
        async def send(self, message: Any, *payload: bytes) -> None:
            await asyncio.sleep(0.1)
            await super().send(message, *payload)

    finders = Viewfinders()
    async with opening(finders) as open_stream:
        a, b = open_stream("a", stream=Slow()), open_stream("b")
        await asyncio.sleep(0.1)
        wanting = asyncio.ensure_future(finders.want("desk", ALL))
        await asyncio.sleep(0.05)
        b.say(None)
        await wanting
        assert (a.take(), b.take()) == ([ALL], [])


async def test_previews_of_a_machine_have_so_much_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_PREVIEW_BYTES", 10)
    monkeypatch.setattr(module, "MAX_PREVIEW_BYTES_PER_MACHINE", 20)
    finders = Viewfinders()
    await finders.want("desk", ALL)
    async with opening(finders) as open_stream:
        a, b, c = (open_stream(name) for name in "abc")
        other = open_stream("other", "another machine")

        async def send(stream: FakeStream, name: str, payload: bytes) -> None:
            stream.say(preview(name, 1), payload)
            await stream.is_read()
            assert stream.take()[-1] == PreviewSeen(camera=name), "its node waits for this in any case"

        await send(a, "a", b"x" * 11)
        assert shown(finders) == {}, "it is too large"
        await send(a, "a", b"a" * 10)
        await send(b, "b", b"b" * 4)
        await send(b, "b", b"B" * 6)
        assert shown(finders) == {"a": b"a" * 10, "b": b"B" * 6}
        await send(c, "c", b"c")
        await send(other, "other", b"o" * 10)
        assert shown(finders).keys() == {"a", "b", "other"}, "the machine of a and b has no room"
        await send(b, "b", b"n" * 5)
        assert shown(finders)["b"] == b"n" * 5, "it replaces its oldest"
        await send(c, "c", b"c" * 5)
        await send(c, "c", b"d")
        assert shown(finders)["c"] == b"c" * 5


async def test_a_new_stream_of_a_camera_replaces_the_one_it_has_abandoned() -> None:
    finders = Viewfinders()
    async with opening(finders) as open_stream:
        old = open_stream("a")
        old.say(CameraHealth(fps=30.0))
        await old.is_read()
        assert finders.health == {"a": CameraHealth(fps=30.0)}
        asked = asyncio.ensure_future(finders.ask(DetailRequest(camera="a"), NodeDetail))
        await asyncio.sleep(0.1)
        new = open_stream("a")
        await asyncio.sleep(0.1)
        assert (old.is_aborted, new.is_aborted) == (True, False)
        with pytest.raises(IncompleteError, match="a has no open stream"):
            await asked
        new.say(CameraHealth(fps=25.0))
        await new.is_read()
        assert finders.health == {"a": CameraHealth(fps=25.0)}
        new.say(None)
        await new.is_read()
        assert finders.health == {}


async def test_requests_of_a_kind_are_answered_one_after_the_other() -> None:
    finders = Viewfinders()
    async with opening(finders) as open_stream:
        a = open_stream("a")
        await a.is_read()
        first, second = ControlsRequest(camera="a"), DetailRequest(camera="a")
        controls = asyncio.ensure_future(finders.ask(first, ControlsAnswer))
        detail = asyncio.ensure_future(finders.ask(second, NodeDetail))
        await asyncio.sleep(0.1)
        assert a.take() == [first]
        a.say(NodeDetail(camera="a", spool="/early"))
        a.say(ControlsAnswer(camera="a", state=EMPTY))
        assert (await controls).state == EMPTY
        await asyncio.sleep(0.1)
        assert a.take() == [second]
        a.say(NodeDetail(camera="a", spool="/spool"))
        assert (await detail).spool == "/spool"


async def test_a_node_that_does_not_answer_is_told_and_its_stream_ended() -> None:
    finders = Viewfinders()
    async with opening(finders) as open_stream:
        a = open_stream("a")
        await a.is_read()
        with pytest.raises(IncompleteError, match="a does not answer"):
            await finders.ask(DetailRequest(camera="a"), NodeDetail)
        assert a.is_aborted, "a late answer would be that to the next request"


async def test_a_phone_is_ended_over_its_stream() -> None:
    finders = Viewfinders()
    async with opening(finders) as open_stream:
        with pytest.raises(IncompleteError, match="phone has no open stream"):
            await finders.put_off("phone")
        phone = open_stream("phone")
        await phone.is_read()
        await finders.put_off("phone")
        assert phone.take() == [RemoveCamera(name="phone")]
        phone.is_broken = True
        await finders.put_off("phone")
        assert phone.is_aborted
