"""Reference clock for chrony: the time of a rig's leader, as samples for the refclock driver SOCK.

A sample is chrony's `struct sock_sample` (refclock_sock.c) in the machine's own byte order: the system clock
as a `struct timeval`, then as a double how far that clock is slow (s), then the ints pulse, leap, _pad and
the magic number "SOCK". chronyd makes the socket; a sample is a datagram to it.
"""

import asyncio
import socket
import struct
import time
from pathlib import Path

from capture_app.common import system
from capture_app.common.address import Address
from capture_app.common.errors import NetworkError, NotAvailableError
from capture_app.net.channel import connect
from capture_app.protocol import messages
from capture_app.rig.rig_time import LeaderTime, read_rig_time

SOCK_SAMPLE = struct.Struct("@lld4i")
"""tv_sec, tv_usec, offset, pulse, leap, _pad, magic."""
SOCK_MAGIC = 0x534F434B
SAMPLE_EVERY_S = 1.0
AGAIN_S = 2.0
"""Time until a lost leader is asked again."""


def sock_sample(now: LeaderTime, system_ns: int) -> bytes:
    """Return the sample of a rig's time at the system clock's reading `system_ns` (Unix time) at that moment.

    The true time is the leader's wall clock's.
    """
    rig_ns = now.leader_ns + now.unix_less_leader_ns
    seconds, microseconds = divmod(system_ns // 1000, 1_000_000)
    return SOCK_SAMPLE.pack(seconds, microseconds, (rig_ns - system_ns) / 1e9, 0, 0, 0, SOCK_MAGIC)


async def feed_chrony(leader: Address, path: Path, every_s: float = SAMPLE_EVERY_S) -> None:
    """Send a sample per `every_s` to chronyd's socket, until cancelled; a lost leader is asked again.

    Raises NotAvailableError if the socket is missing or does not accept samples at the start.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        try:
            sock.connect(str(path))
        except OSError as error:
            raise NotAvailableError(
                f"chronyd does not listen at {path}: {error.strerror or error}",
                hint=f"add to chrony.conf: refclock SOCK {path} refid RIG; then restart chronyd",
            ) from error
        is_first = True
        while True:
            try:
                async with await connect(leader, messages.FromLeader) as channel:
                    while True:
                        now = await read_rig_time(channel)
                        is_first = False
                        _send(sock, path, now)
                        await asyncio.sleep(every_s)
            except NetworkError:
                if is_first:
                    raise
                await asyncio.sleep(AGAIN_S)


def _send(sock: socket.socket, path: Path, now: LeaderTime) -> None:
    local_ns, system_ns = system.monotonic_ns(), time.time_ns()
    try:
        sock.send(sock_sample(now.at(local_ns), system_ns))
    except (ConnectionError, FileNotFoundError):
        # chronyd was restarted and has made a new socket.
        try:
            sock.connect(str(path))
        except OSError:
            return
    except BlockingIOError:
        return
