"""Answers of a leader to the images of one stream: in their order, signed for a relay, and soon enough."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from msgspec.structs import replace

from capture_app.common.errors import BadInputError, DiskFullError, NetworkError
from capture_app.node.leader.service import STILL_SAVING_EVERY_S, ImageAnswers
from capture_app.protocol.messages import ImageAck, ImageBatch, Refusal, ReportAck, SpoolSpace
from capture_app.trust.identity import is_proven
from capture_app.trust.trust import Trust
from tests.unit.node.bursts import report, upload
from tests.unit.node.leader.fake_streams import FakeStream

pytestmark = pytest.mark.virtual

BATCHES = [ImageBatch(images=(upload("a", instant),)) for instant in range(4)]


@asynccontextmanager
async def answering(
    trust: Trust | None = None, *, via: str = ""
) -> AsyncIterator[tuple[ImageAnswers, FakeStream]]:
    stream = cast(Any, FakeStream())
    stream.who = SimpleNamespace(via=via)
    answers = ImageAnswers(stream, trust or Trust.open())
    yield answers, stream
    await answers.close()
    assert not [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]


def saving(answers: ImageAnswers, count: int) -> "list[asyncio.Future[str]]":
    """Let so many batches wait for the disk."""
    futures = [asyncio.get_running_loop().create_future() for _ in range(count)]
    for batch, future in zip(BATCHES, futures, strict=False):
        answers.put_nowait((batch, future))
    return futures


async def test_images_are_answered_in_their_order_however_they_are_saved() -> None:
    async with answering() as (answers, stream):
        first, second, third, fourth = saving(answers, 4)
        fourth.set_result("of the fourth")
        third.cancel()
        second.set_exception(DiskFullError("the disk is full", hint="make room"))
        await asyncio.sleep(1)
        assert stream.take() == []
        first.set_result("of the first")
        await answers.join()
        refusal = Refusal.of_error(DiskFullError("the disk is full", hint="make room"))
        assert refusal.retry
        assert stream.take() == [ImageAck(sha256="of the first"), refusal, ImageAck(sha256="of the fourth")]


async def test_a_node_learns_that_its_images_are_still_being_saved() -> None:
    """Else it takes a leader whose disk is slow for a lost one."""
    async with answering() as (answers, stream):
        (future,) = saving(answers, 1)
        await asyncio.sleep(STILL_SAVING_EVERY_S * 0.9)
        assert stream.take() == []
        await asyncio.sleep(STILL_SAVING_EVERY_S * 2)
        assert stream.take() == [ImageAck(), ImageAck()]
        future.set_result("saved")
        await answers.join()
        assert stream.take() == [ImageAck(sha256="saved")]


async def test_answers_to_a_stream_that_broke_off_are_left_out() -> None:
    async with answering() as (answers, stream):
        stream.is_broken = True
        first, second = saving(answers, 2)
        first.set_result("of the first")
        await asyncio.sleep(1)
        stream.is_broken = False
        second.set_result("of the second")
        await answers.join()
        assert stream.take() == [ImageAck(sha256="of the second")]
        stream.is_broken = True
        with pytest.raises(NetworkError):
            await answers.send(BATCHES[0], ImageAck())


async def test_answers_about_a_burst_are_signed_where_a_relay_passes_them_on(tmp_path: Path) -> None:
    trust = Trust(tmp_path)
    said: list[tuple[Any, Any]] = [
        (report("a", 0), ReportAck(requested=(0,))),
        (report("a", 0), Refusal(what="it was cancelled", forget=True)),
        (BATCHES[0], ImageAck(sha256="of the first")),
        (SpoolSpace(camera="a", free_bytes=1, spool="/"), ReportAck()),
        (BATCHES[0], Refusal.of_error(BadInputError("no such burst"))),
    ]
    for via in ("", "hall"):
        async with answering(trust, via=via) as (answers, stream):
            for message, answer in said:
                await answers.send(message, answer)
            sent = stream.take()
            assert [replace(answer, proof=None) for answer in sent] == [answer for _, answer in said]
            for (message, plain), answer in zip(said, sent, strict=True):
                is_signed = bool(via) and not isinstance(message, SpoolSpace)
                about = (message.camera, 77, 1) if is_signed else ()
                assert is_proven(answer.proof, {trust.identity.pin}, about, plain) is is_signed
