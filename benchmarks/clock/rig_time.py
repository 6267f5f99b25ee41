"""The rig's time as operators read it, against the truth.

Real sockets of the loopback, and a leader with a simulated clock in a process of its own: its clock is known,
and wrong by hours and 30 ppm.
"""

import asyncio
import multiprocessing
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.report import Columns, Report, new_parser, print_report, print_rows
from capture_app.common.address import Address, parse_address
from capture_app.common.clock import SimulatedClock
from capture_app.common.host_clock import host_from_monotonic
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.rig.rig_time import LeaderTime, place_mark, rig_time
from capture_app.trust.trust import Trust

COLUMNS: Columns = {
    "name": ("", ""),
    "count": ("times", ""),
    "rms_us": ("error RMS us", ".0f"),
    "max_us": ("largest", ".0f"),
    "bound_us": ("bound us, median", ".0f"),
    "inside": ("inside", ".1%"),
}
CLOCK = SimulatedClock(offset_ns=7_200_000_000_000, skew_ppm=30.0)


def _lead(sessions: str, trust: str, told: Connection) -> None:
    async def lead() -> None:
        options = LeaderOptions(
            sessions=Path(sessions), host="127.0.0.1", port=0, clock=CLOCK, trust=Trust(Path(trust))
        )
        async with await LeaderNode.start(options) as leader:
            told.send(str(leader.own_address))
            await asyncio.to_thread(told.recv)

    asyncio.run(lead())


def error_ns(found: LeaderTime) -> int:
    """Return the error of a time's middle, ns."""
    return found.leader_ns - CLOCK.local_from_true(host_from_monotonic(found.local_ns))


async def measure(leader: Address, count: int) -> Report:
    """Read the time and set marks so often."""
    times = [await rig_time(leader) for _ in range(count)]
    rows = [tally("now", [error_ns(one) for one in times], [one.uncertainty_ns for one in times])]
    errors, bars = [], []
    for _ in range(count):
        called_ns = time.monotonic_ns()
        mark = (await place_mark(leader, "stimulus", called_ns)).mark
        errors.append(mark.leader_ns - CLOCK.local_from_true(host_from_monotonic(called_ns)))
        bars.append(mark.uncertainty_ns)
    return {"kind": "simulated", "times": [*rows, tally("marks", errors, bars)]}


def tally(name: str, errors_ns: list[int], bars_ns: list[int]) -> dict[str, Any]:
    """Return the errors of times, and how many are within their bounds."""
    errors, bars = np.abs(errors_ns) / 1e3, np.array(bars_ns) / 1e3
    return {
        "name": name,
        "count": len(errors),
        "rms_us": float(np.sqrt((errors**2).mean())),
        "max_us": float(errors.max()),
        "bound_us": float(np.median(bars)),
        "inside": float((errors <= bars).mean()),
    }


def main() -> None:
    """Run it."""
    parser = new_parser(__doc__)
    parser.add_argument("--count", type=int, default=200, help="readings and marks (200)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        trust = Trust(Path(folder) / "trust")
        here, there = multiprocessing.Pipe()
        process = multiprocessing.get_context("spawn").Process(
            target=_lead, args=(f"{folder}/sessions", f"{folder}/trust", there)
        )
        process.start()
        with trust.in_use():
            report = asyncio.run(measure(parse_address(here.recv()), options.count))
        here.send("end")
        process.join()
    print_report(report, lambda found: print_rows(found["times"], COLUMNS), as_json=options.json)


if __name__ == "__main__":
    main()
