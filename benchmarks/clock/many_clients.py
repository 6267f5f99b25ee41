"""One leader, a thousand clients over real UDP on this machine's loopback: what it costs the leader.

The leader and the clients are the engine's own, behind the node's own pump: the leader in one process, the
clients in two more, each on a socket of its own. All join at once; each then asks for the time once a second
and sends the heartbeats of a camera's node. With `--first-samples` each begins as a camera's node does, with
300 exchanges 3 ms apart. All share one clock, so the truth is known. Prints a table; `--json` prints one
object instead. Runs for half a minute.
"""

import asyncio
import os
import socket
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from random import Random
from typing import cast

from benchmarks.report import new_parser, print_report, print_table, talk
from capture_app.common.address import Address
from capture_app.common.camera_facts import SIMULATED, CameraFacts, PhaseControl, TimestampSource
from capture_app.common.clock import HostClock
from capture_app.net.udp import Pump, SinglePeerEngine, client_socket
from capture_app.sync.rig.events import Joined
from capture_app.sync.rig.leader import Leader, LeaderConfig
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.timekeeping.poll_schedule import FIRST_PACE_NS, FIRST_SAMPLES, SteadySchedule
from capture_app.sync.timekeeping.timekeeper import Timekeeper

MOST_CLIENTS = 2000
MOST_SECONDS = 60.0
PROCESSES = 2
JOIN_S = 60.0
FIRST_S = 180.0
LOOK_EVERY_S = 0.05
TARGET_CORES = 0.5
CAMERA = CameraFacts(
    kind=SIMULATED,
    model="none",
    width=0,
    height=0,
    period_ns=33_333_333,
    phase_control=PhaseControl.NONE,
    timestamp_source=TimestampSource.UNKNOWN,
)


@dataclass(frozen=True, slots=True)
class Load:
    """What the clients do: `pace_s` between a client's exchanges, `heartbeat_s` between its heartbeats."""

    clients: int
    seconds: float
    pace_s: float
    heartbeat_s: float
    first_samples: int


class SparingSchedule(SteadySchedule):
    """The engine's own but for ten estimates a second, which two processes cannot bear for all clients."""

    def estimated(self, now_ns: int) -> None:
        """The next estimate is after the benchmark."""
        self.estimate_due_ns = now_ns + round((JOIN_S + FIRST_S + MOST_SECONDS) * 1e9)


class LoadClient(SinglePeerEngine):
    """The engine's client on a socket of its own; counts what passes."""

    def __init__(self, number: int, load: Load, leader: Address) -> None:
        pace_ns = round(load.pace_s * 1e9)
        first_pace_ns = FIRST_PACE_NS if load.first_samples else pace_ns
        schedule = SparingSchedule(
            first_pace_ns=first_pace_ns, easing_paces_ns=(), pace_ns=pace_ns, near_ns=0
        )
        self.timekeeper = Timekeeper(number, schedule)
        heartbeat_ns = round(load.heartbeat_s * 1e9)
        self.client = TimeClient(
            f"c{number}", number + 1, self.timekeeper, CAMERA, heartbeat_every_ns=heartbeat_ns
        )
        super().__init__(self.client, leader)
        self.joins = self.received = self.sent = 0
        self._pump = Pump(self, HostClock(), self._note_events)
        self._pump.start(client_socket(socket.AF_INET))

    def receive_datagram(self, data: bytes, address: tuple[str, int], now_ns: int) -> None:
        """Count a datagram, and take it in."""
        self.received += 1
        super().receive_datagram(data, address, now_ns)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, tuple[str, int]]]:
        """Return what is due, and count it."""
        datagrams = super().datagrams_to_send(now_ns)
        self.sent += len(datagrams)
        return datagrams

    def counts(self) -> tuple[int, int, int, int]:
        """Requests and replies, and all else that was sent and received: heartbeats and their answers."""
        requests, replies = self.timekeeper.requests, self.timekeeper.clock.samples
        return requests, replies, self.sent - requests, self.received - replies

    def _note_events(self) -> None:
        while (event := self.client.next_event()) is not None:
            self.joins += isinstance(event, Joined)


def main() -> int:
    """Run it; 0 if the leader needs less than half a core and answers nearly all, 1 if not."""
    options = _options()
    first_samples = FIRST_SAMPLES if options.first_samples else 0
    load = Load(options.clients, options.seconds, options.pace, options.heartbeat, first_samples)
    context = get_context("spawn")
    here, there = context.Pipe()
    leader = context.Process(target=_leader, args=(there,), daemon=True)
    leader.start()
    port = here.recv()
    crowds = []
    for index in range(PROCESSES):
        mine, theirs = context.Pipe()
        crowd = context.Process(target=_crowd, args=(theirs, port, index, load), daemon=True)
        crowd.start()
        crowds.append((crowd, mine))
    pipes = [pipe for _, pipe in crowds]
    began = _look(here)
    if not _all_say(pipes, JOIN_S):
        talk(f"not all of {load.clients} clients could join within {JOIN_S:g} s")
        return 1
    joined = _look(here)
    if not _all_say(pipes, FIRST_S):
        talk(f"not all had {load.first_samples} answers within {FIRST_S:g} s")
        return 1
    settled = _look(here)
    firsts = [pipe.recv() for pipe in pipes]
    for pipe in pipes:
        pipe.send("go on")
    time.sleep(load.seconds)
    ended = _look(here)
    here.send("end")
    cpu_s, elapsed_s = ended[0] - settled[0], ended[1] - settled[1]
    counts = [pipe.recv() for pipe in pipes]
    totals = {
        key: sum(count[key] for count in counts) for key in ("requests", "replies", "heartbeats", "acks")
    }
    errors_us = sorted(error for count in counts for error in count["errors_us"])
    report = {
        "kind": "real (loopback)",
        **asdict(load),
        **totals,
        "seconds_to_join": joined[1] - began[1],
        "first_requests": sum(requests for requests, _ in firsts),
        "first_replies": sum(replies for _, replies in firsts),
        "seconds_until_all_had_first": settled[1] - began[1],
        "leader_cores_until_then": (settled[0] - began[0]) / (settled[1] - began[1]),
        "leader_cores": cpu_s / elapsed_s,
        "leader_us_per_exchange_or_heartbeat": 1e6 * cpu_s / max(1, totals["replies"] + totals["acks"]),
        "clock_error_us": {
            "median": errors_us[len(errors_us) // 2],
            "p99": errors_us[int(0.99 * len(errors_us))],
        },
        "load_average": os.getloadavg()[0],
    }
    for process in (leader, *(crowd for crowd, _ in crowds)):
        process.join(5.0)
    print_report(report, _print, as_json=options.json)
    answered = totals["replies"] >= 0.99 * totals["requests"]
    return 0 if report["leader_cores"] < TARGET_CORES and answered else 1


def _look(leader: Connection) -> tuple[float, float]:
    leader.send("look")
    return cast(tuple[float, float], leader.recv())


def _all_say(pipes: list[Connection], within_s: float) -> bool:
    """Whether all have said that they are done within that time."""
    deadline_s = time.monotonic() + within_s
    return all(pipe.poll(max(0.0, deadline_s - time.monotonic())) and bool(pipe.recv()) for pipe in pipes)


def _print(report: dict[str, object]) -> None:
    rows = [(k, f"{v:.3g}" if isinstance(v, float) else str(v)) for k, v in report.items()]
    print_table(("figure", "value"), rows)


def _leader(pipe: Connection) -> None:
    asyncio.run(_lead(pipe))


async def _lead(pipe: Connection) -> None:
    """Serve until told to end; tell the processor time and the time whenever asked, in s."""
    loop = asyncio.get_running_loop()
    engine = Leader(LeaderConfig(1, 0), Random(1))

    def after_turn() -> None:
        while engine.next_event() is not None:
            pass

    pump = Pump(engine, HostClock(), after_turn)
    sock = client_socket(socket.AF_INET)
    sock.bind(("127.0.0.1", 0))
    pump.start(sock)
    pipe.send(sock.getsockname()[1])
    while await loop.run_in_executor(None, pipe.recv) != "end":
        pipe.send((time.process_time(), time.monotonic()))
    await asyncio.sleep(1.0)
    pump.close()


def _crowd(pipe: Connection, port: int, index: int, load: Load) -> None:
    asyncio.run(_run_clients(pipe, port, index, load))


async def _run_clients(pipe: Connection, port: int, index: int, load: Load) -> None:
    loop = asyncio.get_running_loop()
    leader = Address("127.0.0.1", port)
    clients = [LoadClient(number, load, leader) for number in range(index, load.clients, PROCESSES)]
    await _until_all(clients, lambda client: client.joins > 0)
    pipe.send("joined")
    await _until_all(clients, lambda client: client.timekeeper.clock.samples >= load.first_samples)
    pipe.send("settled")
    pipe.send(_totals(clients)[:2])
    await loop.run_in_executor(None, pipe.recv)
    before = _totals(clients)
    await asyncio.sleep(load.seconds)
    sums = [b - a for a, b in zip(before, _totals(clients), strict=True)]
    now_ns = time.monotonic_ns()
    maps = [client.timekeeper.clock.time_map(now_ns) for client in clients]
    errors_us = [abs(one.leader_from_local(now_ns) - now_ns) / 1000.0 for one in maps if one is not None]
    if any(client.joins > 1 for client in clients):
        talk(f"{sum(client.joins > 1 for client in clients)} had to join again")
    named = dict(zip(("requests", "replies", "heartbeats", "acks"), sums, strict=True))
    pipe.send({**named, "errors_us": errors_us})


async def _until_all(clients: Sequence[LoadClient], done: Callable[[LoadClient], bool]) -> None:
    while not all(map(done, clients)):  # noqa: ASYNC110 - a thousand events would cost what is measured
        await asyncio.sleep(LOOK_EVERY_S)


def _totals(clients: Sequence[LoadClient]) -> list[int]:
    return [sum(column) for column in zip(*(client.counts() for client in clients), strict=True)]


def _options() -> Namespace:
    parser = new_parser(__doc__)
    parser.add_argument("--clients", type=int, default=1000, help=f"at most {MOST_CLIENTS}")
    parser.add_argument("--seconds", type=float, default=30.0, help=f"at most {MOST_SECONDS:g}")
    parser.add_argument("--pace", type=float, default=1.0, help="seconds between a client's exchanges")
    parser.add_argument("--heartbeat", type=float, default=0.5, help="seconds between a client's heartbeats")
    parser.add_argument(
        "--first-samples", action="store_true", help="begin with 300 exchanges each in quick succession"
    )
    options = parser.parse_args()
    if not (2 <= options.clients <= MOST_CLIENTS and 1.0 <= options.seconds <= MOST_SECONDS):
        parser.error(f"2 to {MOST_CLIENTS} clients, 1 to {MOST_SECONDS:g} seconds")
    if min(options.pace, options.heartbeat) < 0.1:
        parser.error("a pace of 0.1 seconds or more")
    return options


if __name__ == "__main__":
    sys.exit(main())
