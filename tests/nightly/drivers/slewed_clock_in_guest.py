"""Slew a virtual machine's own clock as NTP daemons do, and write how wrong times brought out of it are."""

import ctypes
import json
import sys
import time
from pathlib import Path
from typing import Any

from capture_app.common.host_clock import host_from_monotonic, read_pair

ADJ_TICK, TICK_US = 0x4000, 10_000
FAST_US = TICK_US + TICK_US // 12
"""chrony's limit."""
PAUSE_S = 0.005
LATE = 60
"""So many readings later a time is brought over: as late as a slow driver delivers a frame."""


class Timex(ctypes.Structure):
    """`struct timex` of adjtimex(2), as far as the tick."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("before_tick", ctypes.c_long * 10),
        ("tick", ctypes.c_long),
        ("rest", ctypes.c_long * 32),
    )


def tick(us: int) -> None:
    """Have the kernel count `us` microseconds in each hundredth of a second."""
    asked = Timex(modes=ADJ_TICK, tick=us)
    if ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(asked)) < 0:
        raise OSError(ctypes.get_errno(), "adjtimex")


def errors_ns(seconds: float) -> list[int]:
    """Bring the times of so many seconds over, each some readings later; what each is off, ns."""
    pairs, errors = [], []
    for _ in range(round(seconds / PAUSE_S)):
        pairs.append(read_pair())
        monotonic_ns, host_ns = pairs[max(0, len(pairs) - LATE)]
        errors.append(host_from_monotonic(monotonic_ns) - host_ns)
        time.sleep(PAUSE_S)
    return errors


def main() -> dict[str, Any]:
    """Times before, in and after a slew, and by how much the monotonic clock ran too fast in it."""
    found: dict[str, Any] = {"before": errors_ns(1.0)}
    begun = read_pair()
    tick(FAST_US)
    found["slewed"] = errors_ns(2.0)
    ended = read_pair()
    tick(TICK_US)
    found["after"] = errors_ns(1.0)
    found["ahead_ns"] = (ended[0] - begun[0]) - (ended[1] - begun[1])
    return found


Path(sys.argv[1]).write_text(json.dumps(main()))
