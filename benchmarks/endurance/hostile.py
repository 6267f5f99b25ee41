"""Strangers against a running rig: datagrams, frames over TCP, and connections that say nothing, or half.

A leader, a relay and nodes of simulated cameras are processes of their own on this machine's loopback.
Messages of the protocol with values out of range, nested, cut, and with bytes changed, go to the UDP ports
of all of them, and over streams to leader and relay; connections are held open, idle and with half a header.
Half of what goes to leader and relay is a stranger's; half is a known machine's, sealed with a key that it
was given, and over TLS. With SIMULSHOT_OPEN=1 there is no such difference.
Meanwhile a paired machine that means harm takes names, streams, pictures, votes and bursts of others, and an
operator asks for the status again and again. All of it goes by a trust folder of its own.
Then the rig takes bursts. 0 if nothing of another's was granted, none has said anything of an exception, a
burst is whole within its time, and memory has grown by no more than its limit; 1 if not.

    python -m benchmarks.endurance.hostile --datagrams 200000 --frames 20000 --connections 1000
"""

import asyncio
import math
import os
import random
import resource
import socket
import statistics
import struct
import sys
import tempfile
from argparse import Namespace
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any, get_args

from msgspec import inspect

from benchmarks.endurance.field_attacks import attacks, example
from benchmarks.endurance.hostile_messages import INSIDER, hostile_datagram, hostile_frame
from benchmarks.endurance.paired import PairedThief, paired_machine
from benchmarks.endurance.soak import Soak, Watched, camera_command, listening, start, wait_until_ready
from benchmarks.report import new_parser, print_report, print_rows, talk
from capture_app.common.address import Address, parse_address
from capture_app.common.errors import NetworkError
from capture_app.net.channel import connect
from capture_app.protocol import messages as wire
from capture_app.rig.rig_link import ask_status
from capture_app.trust.datagram_keys import LeaderKeys
from capture_app.trust.trust import Trust

BURST_S = 10.0
MEMORY_MB = 60.0
TURN = 500
"""Number of messages sent before the processes get to run."""


async def keys_of(leaders: list[Address]) -> LeaderKeys:
    """Return the keys that a known machine is given; none in an open rig."""
    keys = LeaderKeys()
    for leader in [] if Trust.of_user().is_open else leaders:
        async with await connect(leader, wire.FromLeader) as channel:
            await channel.send(wire.KeyRequest(name=INSIDER.name, instance=INSIDER.instance))
            answer = await channel.receive_header()
            assert isinstance(answer, wire.KeyAnswer), answer
            keys.hold(leader, answer.grant)
    return keys


async def flood(
    places: list[Address], datagrams: int, until_s: float, rng: random.Random, keys: LeaderKeys
) -> int:
    """Send datagrams to all addresses, every other one sealed if there is a key; return their number."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with sock:
        for number in range(datagrams):
            if number % 2_000 == 0:
                sock.close()
                sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            with suppress(OSError):
                place, data = places[number % len(places)], hostile_datagram(rng)
                sealed = keys.seal(data, place) if rng.random() < 0.5 else None
                sock.sendto(sealed or data, tuple(place))
            if number % TURN == 0:
                await asyncio.sleep(0.002)
                if asyncio.get_running_loop().time() > until_s:
                    break
    sock.close()
    return min(number + 1, datagrams)


async def attack_each_field(leader: Address, machine: Trust) -> int:
    """Send each message with each of its fields changed, as a paired machine does; return their number."""
    sent = 0
    for kind in get_args(wire.ToLeader):
        info = inspect.type_info(kind)
        for _, plain in attacks(info, example(info)):
            # A stream of its own for each: the leader closes it at the first message that it cannot read.
            with suppress(OSError, OverflowError, TypeError, NetworkError):
                async with (
                    asyncio.timeout(10.0),
                    await connect(leader, wire.FromLeader, trust=machine) as channel,
                ):
                    await channel.send(plain)
                    sent += 1
    return sent


async def pester(places: list[Address], frames: int, until_s: float, rng: random.Random) -> int:
    """Send frames over streams, several on each while it is open; return their number."""
    sent = 0
    while sent < frames and asyncio.get_running_loop().time() < until_s:
        try:
            context = Trust.of_user().client_context() if rng.random() < 0.5 else None
            reader, writer = await asyncio.open_connection(*rng.choice(places), ssl=context)
        except OSError:
            await asyncio.sleep(0.05)
            continue
        with suppress(OSError):
            for _ in range(rng.randrange(1, 6)):
                writer.write(hostile_frame(rng))
                sent += 1
            await writer.drain()
            with suppress(TimeoutError):
                async with asyncio.timeout(0.01):
                    await reader.read(1 << 16)
        writer.transport.abort()
    return sent


def dropped_datagrams() -> int:
    """Return the datagrams dropped at full buffers in this network namespace, for any receiver."""
    head, counts = [
        line.split() for line in Path("/proc/net/snmp").read_text().splitlines() if line.startswith("Udp:")
    ]
    return int(dict(zip(head, counts, strict=True))["RcvbufErrors"])


async def hold(places: list[Address], connections: int) -> list[asyncio.StreamWriter]:
    """Open connections and hold them: some idle, some with half a header."""
    held = []
    half = struct.pack(">4sIQ", b"SSH1", 60_000, 0) + bytes(30_000)
    for number in range(connections):
        with suppress(OSError, TimeoutError):
            async with asyncio.timeout(5.0):
                _, writer = await asyncio.open_connection(*places[number % len(places)])
            if number % 2:
                writer.write(half)
            held.append(writer)
    return held


@asynccontextmanager
async def rig(folder: Path) -> AsyncIterator[tuple[Soak, Address]]:
    """Run a leader with one node and a relay with another; yield also the relay's address."""
    where = ("--host", "127.0.0.1", "--port", "0")
    processes = {"leader": await start("leader", "leader", *where, "--sessions", str(folder / "sessions"))}
    try:
        leader = await listening(processes["leader"].child)
        processes["relay"] = await start("relay", "relay", str(leader), "--name", "relay", *where)
        relay = await listening(processes["relay"].child, "relay at ")
        for name, parent in (("cam1", leader), ("cam2", relay)):
            processes[name] = await start(name, *camera_command(name, folder, parent))
        await wait_until_ready(leader, 3)
        yield Soak(leader, processes), relay
    finally:
        await asyncio.gather(*(of.child.stop() for of in processes.values()))


async def attack(options: Namespace, folder: Path) -> dict[str, Any]:
    """Run the rig, attack it, take bursts, and return the results."""
    rng = random.Random(options.seed)
    errors: dict[str, list[str]] = {}
    async with rig(folder) as (run, relay):
        for name, process in run.processes.items():
            errors[name] = []
            process.child.on_line = lambda line, to=errors[name]: (
                to.append(line) if any(word in line for word in ("Traceback", "Error", "xception")) else None
            )
        request = wire.BurstRequest(frames=2, spare=0)
        await run.take(request, keep=True)
        read_all(run.processes, 0)
        nodes = [parse_address(node.address) for node in (await ask_status(run.leader)).nodes]
        places = list(dict.fromkeys([run.leader, relay, *nodes]))
        talk(f"attacking {', '.join(map(str, places))}")
        held = await hold([run.leader, relay], options.connections)
        burst = (await ask_status(run.leader)).burst
        trust = paired_machine(folder / "thief")
        thief = PairedThief(run.leader, trust)
        loop, full = asyncio.get_running_loop(), dropped_datagrams()
        attack_s = loop.time()
        until_s = attack_s + options.seconds
        looking = asyncio.create_task(thief.look())
        fields, _, datagrams, frames = await asyncio.gather(
            attack_each_field(run.leader, trust),
            thief.attack(options.names, (1, 0 if burst is None else burst.burst)),
            flood(places, options.datagrams, until_s, rng, await keys_of([run.leader, relay])),
            pester([run.leader, relay], options.frames, until_s, rng),
        )
        looking.cancel()
        attack_s, full = loop.time() - attack_s, dropped_datagrams() - full
        read_all(run.processes, 1)
        began_s, whole, tries = loop.time(), False, 0
        while not whole and loop.time() - began_s < 10 * BURST_S:
            before, tries = len(run.incomplete), tries + 1
            await run.take(request, keep=True)
            whole = len(run.incomplete) == before
        seconds = loop.time() - began_s
        for writer in held:
            writer.transport.abort()
        status = await ask_status(run.leader)
        read_all(run.processes, 2)
    return {
        "kind": "real (loopback)",
        "seconds": attack_s,
        "datagrams": datagrams,
        "datagrams_at_full_buffers": full,
        "frames": frames,
        "messages_with_one_field_changed": fields,
        "connections": len(held),
        "seconds_to_a_whole_burst": seconds,
        "bursts_until_then": tries,
        "nodes": [node.name for node in status.nodes if not node.name.startswith("made-up")],
        "thief": {
            "names": thief.names,
            "names_granted": thief.welcomes,
            "streams": thief.streams,
            "nodes_at_most": thief.most_nodes,
            "thefts_tried": thief.tried,
            "thefts": thief.thefts,
            "operator_answers": len(thief.answers_s),
            "operator_unanswered": thief.unanswered,
            "operator_waited_median_s": statistics.median(thief.answers_s or [0.0]),
            "operator_waited_s": max(thief.answers_s, default=0.0),
        },
        "processes": [
            {"process": name, "kind": kind, "before": of[0][1], "during": of[1][1], "after": of[2][1]}
            for name, process in run.processes.items()
            for kind, of in process.series.items()
        ],
        "complaints": [
            *(
                []
                if whole and seconds <= BURST_S
                else [f"no whole burst within {BURST_S:g} s, {tries} tried", *run.incomplete[-3:]]
            ),
            *(
                f"{name}: memory grew by {process.series['memory_mb'][2][1] - of[0][1]:.0f} MB"
                for name, process in run.processes.items()
                if (of := process.series["memory_mb"])[2][1] - of[0][1] > MEMORY_MB
            ),
            *([f"{thief.thefts} of {thief.tried} thefts succeeded"] if thief.thefts else []),
            *([] if thief.answers_s else ["no operator was answered"]),
            *([f"an operator was refused {thief.unanswered} times"] if thief.unanswered else []),
            *(f"{name} said: {line}" for name, lines in errors.items() for line in lines[:3]),
            *run.broken,
        ],
    }


def read_all(processes: dict[str, Watched], place: int) -> None:
    """Read the figures of all processes."""
    for process in processes.values():
        process.read(place)


def print_tables(report: dict[str, Any]) -> None:
    """Print a report as tables."""
    columns = {"process": ("process", ""), "kind": ("figure", "")}
    figures = {name: (name, ".1f") for name in ("before", "during", "after")}
    print_rows(report["processes"], columns | figures)
    print(
        f"{report['seconds']:.0f} s of {report['datagrams']} datagrams"
        f" ({report['datagrams_at_full_buffers']} met a full buffer), {report['frames']} frames,"
        f" {report['connections']} connections:"
        f" a whole burst after {report['seconds_to_a_whole_burst']:.1f} s, nodes {', '.join(report['nodes'])}"
    )
    thief = report["thief"]
    print(
        f"a paired machine: {thief['names']} names, at most {thief['nodes_at_most']} nodes at a time,"
        f" {thief['streams']} streams; {thief['thefts']} of {thief['thefts_tried']} thefts; an operator was"
        f" answered {thief['operator_answers']} times, half of them within"
        f" {thief['operator_waited_median_s']:.2f} s, all within {thief['operator_waited_s']:.2f} s"
    )
    for line in report["complaints"]:
        print(f"WRONG: {line}")


def main() -> int:
    """Run it; return 0 if the rig withstands the attack, else 1."""
    parser = new_parser(__doc__, seed_of="what is sent")
    parser.add_argument("--datagrams", type=int, default=200_000)
    parser.add_argument("--frames", type=int, default=5_000)
    parser.add_argument("--connections", type=int, default=1_000)
    parser.add_argument("--names", type=int, default=300)
    parser.add_argument("--seconds", type=float, default=math.inf, help="send no longer than that")
    options = parser.parse_args()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, min(hard, 16_384)), hard))
    with tempfile.TemporaryDirectory(prefix="hostile-") as folder:
        os.environ["XDG_DATA_HOME"] = f"{folder}/data"  # a machine like that is not to stay known
        report = asyncio.run(attack(options, Path(folder)))
    print_report(report, print_tables, as_json=options.json)
    return 1 if report["complaints"] else 0


if __name__ == "__main__":
    sys.exit(main())
