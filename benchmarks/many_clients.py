"""One leader, a thousand clients over real UDP on this machine's loopback: what it costs the leader.

The leader is the engine's own behind the node's own pump, in a process of its own. Two more processes stand
for the clients: each client has its own socket, joins, sends a time request a second and the heartbeats of
a camera's node, and estimates the leader's clock with the engine's own filter; the truth is known, as all
share one clock. All join at once; with `--first 300` each then asks every 3 ms until that many requests are
answered, as a camera's node does. Prints a table; `--json` prints one object instead. Runs for half a minute.
"""

import argparse
import asyncio
import json
import os
import random
import socket
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import cast

from capture_app.camera_facts import CameraFacts, PhaseControl, TimestampSource
from capture_app.net.udp import Pump
from capture_app.sync.clock.clock_filter import ClockFilter
from capture_app.sync.clock.clock_sample import ClockSample
from capture_app.sync.rig.leader import Leader, LeaderConfig
from capture_app.sync.wire.codec import decode, encode
from capture_app.sync.wire.messages import (
    Heartbeat,
    HeartbeatAck,
    Hello,
    NodeState,
    Report,
    UnknownMember,
    Welcome,
)
from capture_app.sync.wire.time_messages import TimeReply, request_at, request_before_t0

MOST_CLIENTS = 2000
MOST_SECONDS = 60.0
PROCESSES = 2
JOIN_S = 60.0
FIRST_S = 120.0
FIRST_PACE_S = 0.003
TARGET_CORES = 0.5
CAMERA = CameraFacts(
    kind="simulated",
    model="stand-in",
    width=0,
    height=0,
    period_ns=33_333_333,
    phase_control=PhaseControl.NONE,
    timestamp_source=TimestampSource.UNKNOWN,
)


@dataclass(frozen=True, slots=True)
class Load:
    """What the clients do: `pace_s` between a client's exchanges, `heartbeat_s` between its heartbeats.

    Each begins with `first` exchanges in quick succession.
    """

    clients: int
    seconds: float
    pace_s: float
    heartbeat_s: float
    first: int


class StandIn(asyncio.DatagramProtocol):
    """A client on a socket of its own."""

    def __init__(self, number: int, load: Load) -> None:
        self.number = number
        self.joined = asyncio.Event()
        self.settled = asyncio.Event()
        self.clock = ClockFilter()
        self.requests = self.replies = self.heartbeats = self.acks = self.joins = 0
        self._load = load
        self._client = 0
        self._t0_ns: dict[int, int] = {}
        self._transport: asyncio.DatagramTransport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the transport."""
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: object) -> None:
        """Take in what the leader sends."""
        now_ns = time.monotonic_ns()
        message = decode(data)
        match message:
            case Welcome():
                self.joins += message.client != self._client
                self._client = message.client
                self.joined.set()
            case TimeReply():
                self.replies += 1
                sample = ClockSample(self._t0_ns.pop(message.sequence), message.t1_ns, message.t2_ns, now_ns)
                self.clock.add(sample)
                if self.replies >= self._load.first:
                    self.settled.set()
            case UnknownMember():
                # The leader has not heard of it for 2 s, on a machine that is far too busy.
                self._say_hello()
            case HeartbeatAck():
                self.acks += 1
            case _:
                raise AssertionError(f"the leader says {message}")

    async def run(self, all_joined: asyncio.Event, until_s: float) -> None:
        """Join; with all others ask for the time and say hello at even paces, in a slot of its own."""
        load = self._load
        while not self.joined.is_set():
            self._say_hello()
            await asyncio.wait([asyncio.ensure_future(self.joined.wait())], timeout=1.0)
        beats = asyncio.create_task(self._every(load.heartbeat_s, 0.0, self._beat, until_s))
        await all_joined.wait()
        while self.replies < load.first:
            self._ask()
            await asyncio.sleep(FIRST_PACE_S)
        beats.cancel()
        self.settled.set()
        turns = [(load.pace_s, self._ask), (load.heartbeat_s, self._beat)]
        slot = self.number / load.clients
        await asyncio.gather(*(self._every(every_s, slot, act, until_s) for every_s, act in turns))

    async def _every(self, every_s: float, slot: float, act: Callable[[], None], until_s: float) -> None:
        due_s = time.monotonic() + slot * every_s
        while due_s < until_s:
            await asyncio.sleep(max(0.0, due_s - time.monotonic()))
            act()
            due_s += every_s

    def _say_hello(self) -> None:
        self._transport.sendto(encode(Hello(f"c{self.number}", self.number + 1, CAMERA)))

    def _ask(self) -> None:
        self.requests += 1
        before = request_before_t0(self._client, self.requests)
        self._t0_ns[self.requests] = now_ns = time.monotonic_ns()
        self._transport.sendto(request_at(before, now_ns))

    def _beat(self) -> None:
        self.heartbeats += 1
        report = Report(state=NodeState.READY, offset_ns=0, skew_ppm=0.0, uncertainty_ns=1000, samples=300)
        self._transport.sendto(encode(Heartbeat(self._client, report)))


def main() -> int:
    """Run it; 0 if the leader needs less than half a core and answers nearly all, 1 if not."""
    options = _options()
    load = Load(options.clients, options.seconds, options.pace, options.heartbeat, options.first)
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
        print(f"not all of {load.clients} clients could join within {JOIN_S:g} s", file=sys.stderr)
        return 1
    joined = _look(here)
    for pipe in pipes:
        pipe.send("go on")
    if not _all_say(pipes, FIRST_S):
        print(f"not all had {load.first} answers within {FIRST_S:g} s", file=sys.stderr)
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
    if options.json:
        print(json.dumps(report, indent=2))
    else:
        for key, value in report.items():
            print(f"{key:38} {value:.3g}" if isinstance(value, float) else f"{key:38} {value}")
    answered = totals["replies"] >= 0.99 * totals["requests"]
    return 0 if report["leader_cores"] < TARGET_CORES and answered else 1


def _look(leader: Connection) -> tuple[float, float]:
    leader.send("look")
    return cast(tuple[float, float], leader.recv())


def _all_say(pipes: list[Connection], within_s: float) -> bool:
    """Whether all have said that they are done within that time."""
    deadline_s = time.monotonic() + within_s
    return all(pipe.poll(max(0.0, deadline_s - time.monotonic())) and bool(pipe.recv()) for pipe in pipes)


def _leader(pipe: Connection) -> None:
    asyncio.run(_lead(pipe))


async def _lead(pipe: Connection) -> None:
    """Serve until told to end; tell the processor time and the time whenever asked, in s."""
    loop = asyncio.get_running_loop()
    engine = Leader(LeaderConfig(1, 0), random.Random(1))

    def after_turn() -> None:
        while engine.next_event() is not None:
            pass

    pump = Pump(engine, time.monotonic_ns, after_turn)
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    sock.bind(("127.0.0.1", 0))
    pump.start(sock)
    pipe.send(sock.getsockname()[1])
    while await loop.run_in_executor(None, pipe.recv) != "end":
        pipe.send((time.process_time(), time.monotonic()))
    await asyncio.sleep(1.0)
    pump.close()


def _crowd(pipe: Connection, port: int, index: int, load: Load) -> None:
    asyncio.run(_stand_in(pipe, port, index, load))


async def _stand_in(pipe: Connection, port: int, index: int, load: Load) -> None:
    loop = asyncio.get_running_loop()
    members: list[StandIn] = []
    until_s = time.monotonic() + JOIN_S + FIRST_S + load.seconds
    all_joined = asyncio.Event()
    tasks = []
    for number in range(index, load.clients, PROCESSES):
        _, member = await loop.create_datagram_endpoint(
            lambda number=number: StandIn(number, load), remote_addr=("127.0.0.1", port)
        )
        members.append(member)
        tasks.append(asyncio.create_task(member.run(all_joined, until_s)))
    await asyncio.gather(*(member.joined.wait() for member in members))
    pipe.send("joined")
    await loop.run_in_executor(None, pipe.recv)
    all_joined.set()
    await asyncio.gather(*(member.settled.wait() for member in members))
    pipe.send("settled")
    pipe.send((sum(m.requests for m in members), sum(m.replies for m in members)))
    await loop.run_in_executor(None, pipe.recv)
    before = [(m.requests, m.replies, m.heartbeats, m.acks) for m in members]
    await asyncio.sleep(load.seconds)
    after = [(m.requests, m.replies, m.heartbeats, m.acks) for m in members]
    sums = [sum(b[i] - a[i] for a, b in zip(before, after, strict=True)) for i in range(4)]
    now_ns = time.monotonic_ns()
    maps = [member.clock.time_map(now_ns) for member in members]
    errors_us = [abs(one.leader_from_local(now_ns) - now_ns) / 1000.0 for one in maps if one is not None]
    if any(member.joins > 1 for member in members):
        print(f"{sum(member.joins > 1 for member in members)} had to join again", file=sys.stderr)
    named = dict(zip(("requests", "replies", "heartbeats", "acks"), sums, strict=True))
    pipe.send({**named, "errors_us": errors_us})
    for task in tasks:
        task.cancel()


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--clients", type=int, default=1000, help=f"at most {MOST_CLIENTS}")
    parser.add_argument("--seconds", type=float, default=30.0, help=f"at most {MOST_SECONDS:g}")
    parser.add_argument("--pace", type=float, default=1.0, help="seconds between a client's exchanges")
    parser.add_argument("--heartbeat", type=float, default=0.5, help="seconds between a client's heartbeats")
    parser.add_argument(
        "--first", type=int, default=0, help="exchanges of each in quick succession, at first"
    )
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if not (2 <= options.clients <= MOST_CLIENTS and 1.0 <= options.seconds <= MOST_SECONDS):
        parser.error(f"2 to {MOST_CLIENTS} clients, 1 to {MOST_SECONDS:g} seconds")
    if not 0 <= options.first <= 1000:
        parser.error("0 to 1000 exchanges at first")
    if min(options.pace, options.heartbeat) < 0.1:
        parser.error("a pace of 0.1 seconds or more")
    return options


if __name__ == "__main__":
    sys.exit(main())
