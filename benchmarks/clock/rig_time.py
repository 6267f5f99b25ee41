"""The rig's time as operators read it, against the truth: `python -m benchmarks.clock.rig_time`.

Real sockets of the loopback, and a leader with a simulated clock in a process of its own: its clock is known,
and wrong by hours and 30 ppm.
"""

import argparse
import asyncio
import multiprocessing
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from capture_app.common.address import Address, parse_address
from capture_app.common.clock import SimulatedClock
from capture_app.common.host_clock import host_from_monotonic
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.rig.rig_time import RigTime, place_mark, rig_time
from capture_app.trust.trust import Trust

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


def error_ns(found: RigTime) -> int:
    """Return the error of a time's middle, ns."""
    return found.leader_ns - CLOCK.local_from_true(host_from_monotonic(found.local_ns))


async def measure(leader: Address, count: int) -> None:
    """Read the time and set marks so often, and print their errors."""
    times = [await rig_time(leader) for _ in range(count)]
    report("now", [error_ns(one) for one in times], [one.uncertainty_ns for one in times])
    errors, bars = [], []
    for _ in range(count):
        called_ns = time.monotonic_ns()
        mark = (await place_mark(leader, "stimulus", called_ns)).mark
        errors.append(mark.leader_ns - CLOCK.local_from_true(host_from_monotonic(called_ns)))
        bars.append(mark.uncertainty_ns)
    report("marks", errors, bars)


def report(name: str, errors_ns: list[int], bars_ns: list[int]) -> None:
    """Print the errors of times, and how many are within their bounds."""
    errors, bars = np.abs(errors_ns) / 1e3, np.array(bars_ns) / 1e3
    rms, inside = np.sqrt((errors**2).mean()), 100 * (errors <= bars).mean()
    print(
        f"{name}: {len(errors)} times, error RMS {rms:.0f} us, largest {errors.max():.0f} us; "
        f"bound {np.median(bars):.0f} us (median), holds for {inside:.1f} %"
    )


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    count = parser.parse_args().count
    with tempfile.TemporaryDirectory() as folder:
        trust = Trust(Path(folder) / "trust")
        here, there = multiprocessing.Pipe()
        process = multiprocessing.get_context("spawn").Process(
            target=_lead, args=(f"{folder}/sessions", f"{folder}/trust", there)
        )
        process.start()
        with trust.in_use():
            asyncio.run(measure(parse_address(here.recv()), count))
        here.send("end")
        process.join()


if __name__ == "__main__":
    main()
