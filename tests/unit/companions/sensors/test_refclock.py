"""chrony's reference clock: datagrams of the documented struct, and a real chronyd whose source they are."""

import asyncio
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from capture_app.common.errors import NotAvailableError
from capture_app.common.tasks import end
from capture_app.companions.sensors.refclock import feed_chrony, sock_sample
from capture_app.rig.rig_time import LeaderTime
from tests.cheap_rig import rig_of

DOCUMENTED = "@qqdiiii"
"""By refclock_sock.c: struct timeval (64-bit Linux), double offset, int pulse, leap, _pad and magic."""


def test_a_sample_is_chronys_struct() -> None:
    now = LeaderTime(5_000_000_000, 5_000_000_200, 77, unix_less_leader_ns=1_700_000_000_000_000_000)
    system_ns = now.leader_ns + now.unix_less_leader_ns - 1_234_567_891
    seconds, microseconds, offset_s, pulse, leap, pad, magic = struct.unpack(
        DOCUMENTED, sock_sample(now, system_ns)
    )
    assert (seconds * 1_000_000 + microseconds) == system_ns // 1000
    assert offset_s == pytest.approx(1.234567891, abs=1e-9)
    assert (pulse, leap, pad, magic) == (0, 0, 0, 0x534F434B)


@contextmanager
def listening(path: Path) -> Iterator[socket.socket]:
    """A socket as chronyd makes it."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.bind(str(path))
        sock.setblocking(False)
        yield sock


async def test_samples_arrive_also_after_chronyd_was_started_again(tmp_path: Path) -> None:
    path = tmp_path / "rig.sock"
    loop = asyncio.get_running_loop()
    async with rig_of(0, tmp_path / "sessions") as leader:
        with listening(path) as sock:
            feeding = asyncio.create_task(feed_chrony(leader.own_address, path, every_s=0.01))
            try:
                for _ in range(3):
                    before_ns = time.time_ns()
                    sample = struct.unpack(DOCUMENTED, await loop.sock_recv(sock, 100))
                    assert sample[-1] == 0x534F434B
                    # The leader's wall clock is this machine's own.
                    assert abs(sample[2]) < 1.0
                    assert abs(sample[0] - before_ns / 1e9) < 60
            except BaseException:
                await end(feeding)
                raise
        path.unlink()
        with listening(path) as sock:
            try:
                assert len(await loop.sock_recv(sock, 100)) == struct.calcsize(DOCUMENTED)
            finally:
                await end(feeding)


async def test_a_missing_socket_is_said(tmp_path: Path) -> None:
    async with rig_of(0, tmp_path / "sessions") as leader:
        with pytest.raises(NotAvailableError, match="chronyd does not listen") as found:
            await feed_chrony(leader.own_address, tmp_path / "none.sock")
    assert "refclock SOCK" in str(found.value)
