"""When a datagram was received, in a node's own time, by the kernel's stamp of it."""

import socket
import struct
import time
from collections.abc import Callable, Iterable

from capture_app.clock import NodeClock

# Linux's number, which the socket module does not have; the stamp is a timespec of CLOCK_REALTIME.
SO_TIMESTAMPNS = 35
_TIMESPEC = struct.Struct("@ll")
ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size)

Reading = Callable[[], int]
"""Returns what a clock of the host shows, in ns."""


class ReceiptTimes:
    """Puts stamps of the kernel into a node's own time: perhaps late, never early.

    A late stamp is forgiven by a filter for the least delay; an early one would break the hard bound. The
    stamps are CLOCK_REALTIME, which runs like CLOCK_MONOTONIC but steps when it is set or the host slept. So
    a stamp is placed by a pair of readings from before the datagram came and by one from after it: a step
    makes one of the two early, and the later one counts. A node's clock may run at another rate than the
    host's, so it is asked for that moment, instead of taking an age off what it shows.
    """

    def __init__(
        self,
        clock: NodeClock,
        *,
        realtime: Reading = time.time_ns,
        monotonic: Reading = time.monotonic_ns,
    ) -> None:
        self._clock, self._realtime, self._monotonic = clock, realtime, monotonic
        self._before = self._after = self._read()

    def received_ns(self, ancillary: Iterable[tuple[int, int, bytes]]) -> int:
        """Local time in ns of the datagram that was just read; now where the kernel does not say."""
        self._after = self._read()
        now_ns = self._after[1]
        for level, kind, stamp in ancillary:
            if (level, kind) == (socket.SOL_SOCKET, SO_TIMESTAMPNS) and len(stamp) == _TIMESPEC.size:
                seconds, nanoseconds = _TIMESPEC.unpack(stamp)
                stamp_ns = seconds * 1_000_000_000 + nanoseconds
                placed_ns = max(
                    mono_ns + stamp_ns - real_ns for real_ns, mono_ns in (self._before, self._after)
                )
                return self._clock.local_from_true(min(placed_ns, now_ns))
        return self._clock.local_from_true(now_ns)

    def queue_was_empty(self) -> None:
        """Note that nothing was left to read: what is still to come is received after the last reading."""
        self._before = self._after

    def _read(self) -> tuple[int, int]:
        # In this order: whatever comes between makes the time late.
        real_ns = self._realtime()
        return real_ns, self._monotonic()
