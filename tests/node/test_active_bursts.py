"""A leader's bursts: ordered, cancelled, and let go when they are saved."""

import asyncio
import gc
import random
import threading
import weakref
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from msgspec.structs import replace

from capture_app.errors import BadInputError
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.leader.active_bursts import ActiveBursts, CancelledBurstError
from capture_app.session.reading.reader import Session
from capture_app.sync.rig.leader import Leader, LeaderConfig
from capture_app.sync.wire.codec import decode
from capture_app.sync.wire.messages import Hello, Trigger
from tests.node.bursts import CAMERA, IMAGE, LEADER, pieces, receive_image, report, upload

NOW_NS = 10**12


def engine_of(*names: str) -> Leader:
    """A leader's engine that these cameras have joined."""
    engine = Leader(LeaderConfig(instance=LEADER, transfer_port=1), random.Random(1))
    for number, name in enumerate(names):
        engine.receive_message(Hello(name, number, CAMERA), (name, 0), NOW_NS)
    return engine


@asynccontextmanager
async def bursts_of(root: Path, engine: Leader) -> AsyncIterator[ActiveBursts]:
    bursts = ActiveBursts(root, engine, lambda: NOW_NS, lambda _: None)
    try:
        yield bursts
    finally:
        await bursts.close()


async def order(bursts: ActiveBursts, frames: int = 2) -> BurstSession:
    return await bursts.order(frames=frames, spacing=1, at_leader_ns=None)


def triggers_sent(engine: Leader) -> list[Trigger]:
    engine.handle_timer(NOW_NS)
    sent = (decode(data) for data, _ in engine.datagrams_to_send(NOW_NS))
    return [message for message in sent if isinstance(message, Trigger)]


async def test_a_cancelled_burst_is_forgotten_by_its_nodes(tmp_path: Path) -> None:
    engine = engine_of("a", "b")
    async with bursts_of(tmp_path, engine) as bursts:
        session = await order(bursts)
        number = session.burst.number
        await session.accept_report(report("a", 0, 1), NOW_NS)
        await bursts.cancel(number)
        assert session.status.done
        assert session.status.session is None
        assert not session.folder.exists()
        assert [(t.burst, t.count) for t in triggers_sent(engine)] == [(number, 0), (number, 0)]
        with pytest.raises(BadInputError, match="not under way"):
            await bursts.cancel(number)
        late = replace(report("b", 0, 1), burst=number)
        with pytest.raises(CancelledBurstError):
            await bursts.find_session(late)
        again = await order(bursts)
        assert again.burst.number > number


async def test_what_was_confirmed_of_a_cancelled_burst_is_kept(tmp_path: Path) -> None:
    engine = engine_of("a", "b")
    async with bursts_of(tmp_path, engine) as bursts:
        session = await order(bursts)
        for name in ("a", "b"):
            await session.accept_report(report(name, 0, 1), NOW_NS)
        await receive_image(session, upload("a", 0), pieces(IMAGE), NOW_NS)
        await bursts.cancel(session.burst.number)
        assert session.session is not None
        manifest = Session.open(session.session).manifest
        assert len(manifest.images) == 1
        assert {gap.reason for gap in manifest.missing} == {"the burst was cancelled"}


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


async def test_two_hundred_bursts_leave_no_threads_and_no_open_files(tmp_path: Path) -> None:
    engine = engine_of("a")
    async with bursts_of(tmp_path, engine) as bursts:
        begun: list[weakref.ref[BurstSession]] = []
        threads, files = [], []
        for _ in range(200):
            session = await order(bursts, frames=1)
            begun.append(weakref.ref(session))
            number = session.burst.number
            told = replace(report("a", 0), burst=number)
            assert (await session.accept_report(told, NOW_NS)).wanted == (0,)
            await receive_image(session, replace(upload("a", 0), burst=number), pieces(IMAGE), NOW_NS)
            assert (await bursts.wait_until_saved(number)).received == 1
            threads.append(threading.active_count())
            files.append(await asyncio.to_thread(open_files))
        assert max(threads[20:]) <= max(threads[:20]) + 8, "a pool may still grow"
        assert max(files[20:]) <= max(files[:20]) + 8
        del session
        gc.collect()
        assert sum(of() is not None for of in begun) <= 2
    assert len(bursts.saved) < 100, "each status tells them"
    assert bursts.saved[-1].endswith("-200")
