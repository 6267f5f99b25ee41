"""A leader's bursts: ordered, cancelled, and let go when they are saved."""

import asyncio
import gc
import threading
import weakref
from pathlib import Path

import pytest
from msgspec.structs import replace

from capture_app.node.burst.burst_session import BurstSession
from tests.unit.node.bursts import IMAGE, pieces, receive_image, report, upload
from tests.unit.node.leader.test_active_bursts import NOW_NS, bursts_of, engine_of, order

pytestmark = pytest.mark.virtual


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
            assert (await session.accept_report(told, NOW_NS)).requested == (0,)
            await receive_image(session, replace(upload("a", 0), burst=number), pieces(IMAGE), NOW_NS)
            await session.finished.wait()
            assert session.status.received == 1
            threads.append(threading.active_count())
            files.append(await asyncio.to_thread(open_files))
        assert max(threads[20:]) <= max(threads[:20]) + 8, "a pool may still grow"
        assert max(files[20:]) <= max(files[:20]) + 8
        del session
        gc.collect()
        assert sum(of() is not None for of in begun) <= 2
    assert len(bursts.saved) < 100, "each status tells them"
    assert bursts.saved[-1].endswith("-200")
