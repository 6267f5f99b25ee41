"""The two ends of `sealed_link`, as processes of their own: a leader, and clients one after the other.

Keys are the same at both ends because both draw them from one seed: how they are handed out is not measured.

    python -m benchmarks.clock.sealed_ends leader 47010 --trials 50 --out FILE [--sealed]
    python -m benchmarks.clock.sealed_ends client 10.77.0.1 --trials 50
"""

import argparse
import asyncio
import json
import random
import signal
import socket
from pathlib import Path
from typing import Any

from capture_app.common.camera_facts import CameraFacts, PhaseControl, TimestampSource
from capture_app.common.clock import HostClock
from capture_app.net.server import bind_port
from capture_app.net.udp import Pump, client_socket
from capture_app.sync.clock.clock_filter import ClockSample
from capture_app.sync.rig.client import Client, ClientConfig
from capture_app.sync.rig.events import BurstAnswered
from capture_app.sync.rig.failover import Failover
from capture_app.sync.rig.leader import Leader, LeaderConfig
from capture_app.sync.rig.orders import BurstOrder
from capture_app.sync.wire.principal import Principal
from capture_app.trust.keys import ClientKeys, Grant
from capture_app.trust.sealed_engines import SealedClient, SealedLeader

OPEN_PORT, SEALED_PORT = 47010, 47011
SECRET = 1
TRIGGERS, TRIGGER_EVERY_S = 20, 0.02
TRIAL_TIMEOUT_S = 30.0
FACTS = CameraFacts(
    kind="sim",
    model="benchmark",
    width=640,
    height=480,
    period_ns=33_333_333,
    phase_control=PhaseControl.NONE,
    timestamp_source=TimestampSource.START_OF_EXPOSURE,
)


def granted(trials: int) -> tuple[ClientKeys, list[Grant]]:
    """Return the keys of the client of each trial, at the leader's end and at the clients'."""
    keys = ClientKeys(random.Random(SECRET).randbytes)
    return keys, [keys.grant(Principal(name_of(trial), trial)) for trial in range(trials)]


def name_of(trial: int) -> str:
    """Return the name of a trial's client."""
    return f"trial-{trial:04d}"


async def lead(port: int, trials: int, *, sealed: bool) -> list[float]:
    """Answer clients until SIGTERM, trigger bursts of those that know the time; return their times in us."""
    datagrams, listening = bind_port("", port)
    listening.close()
    engine, clock = Leader(LeaderConfig(port, 0), random.Random(1)), HostClock()
    asked_ns: dict[int, int] = {}
    answered_ns: list[int] = []

    def drain() -> None:
        while (event := engine.next_event()) is not None:
            if isinstance(event, BurstAnswered) and not event.refusal:
                answered_ns.append(clock.now_ns() - asked_ns.pop(event.burst))

    pump = Pump(SealedLeader(engine, granted(trials)[0]) if sealed else engine, clock, drain)
    pump.start(datagrams)
    stop = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, stop.set)
    while not stop.is_set():
        now_ns = clock.now_ns()
        reports = [view.report for view in engine.roster.by_name()]
        if any(report.uncertainty_ns is not None and report.state != "lost" for report in reports):
            asked_ns.clear()
            burst = engine.trigger(now_ns, BurstOrder(frames=1))
            asked_ns[burst.number] = now_ns
            pump.turn()
        await asyncio.sleep(TRIGGER_EVERY_S)
    pump.close()
    return [ns / 1000 for ns in answered_ns]


async def follow(host: str, port: int, trial: int, grant: Grant | None) -> dict[str, Any]:
    """Join, learn the time and take bursts; return how far off it was, in us."""
    clock, samples = HostClock(), list[ClockSample]()
    config = ClientConfig(name_of(trial), trial, FACTS, 100_000)
    client: Client[None] = Client(config, random.Random(trial), samples=samples)
    engine, leader = Failover(client, ((host, port),)), (host, port)
    sealed = SealedClient(engine)
    if grant is not None:
        sealed.keys.hold(leader, grant)
    done = asyncio.Event()
    found: dict[str, Any] = {}

    def drain() -> None:
        while client.next_event() is not None:
            pass
        time_map = client.time_map
        if not found and client.time.timekeeper.synced and time_map is not None:
            now_ns = clock.now_ns()
            found["error_us"] = (time_map.leader_from_local(now_ns) - now_ns) / 1000
            found["hard_bound_us"] = time_map.hard_bound_at(now_ns) / 1000
            found["round_trip_us"] = min(sample.round_trip_ns for sample in samples) / 1000
            found["samples"] = len(samples)
            done.set()

    pump = Pump(engine if grant is None else sealed, clock, drain)
    pump.start(client_socket(socket.AF_INET))
    try:
        async with asyncio.timeout(TRIAL_TIMEOUT_S):
            await done.wait()
        await asyncio.sleep(TRIGGERS * TRIGGER_EVERY_S)
    finally:
        client.leave()
        pump.turn()
        pump.close()
    return found


async def follow_both(host: str, trials: int) -> None:
    """Take the trials, open and sealed in turns, and print them."""
    grants = granted(trials)[1]
    found: dict[str, list[dict[str, Any]]] = {"open": [], "sealed": []}
    for trial, grant in enumerate(grants):
        ways = [("open", OPEN_PORT, None), ("sealed", SEALED_PORT, grant)]
        for name, port, key in ways if trial % 2 else reversed(ways):
            found[name].append(await follow(host, port, trial, key))
    print(json.dumps(found))


def main() -> None:
    """Run one end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("end", choices=("leader", "client"))
    parser.add_argument("where", help="a leader's port, or the host that clients join")
    parser.add_argument("--trials", type=int, required=True)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--sealed", action="store_true")
    options = parser.parse_args()
    if options.end == "leader":
        times = asyncio.run(lead(int(options.where), options.trials, sealed=options.sealed))
        options.out.write_text(json.dumps({"trigger_us": times}))
    else:
        asyncio.run(follow_both(options.where, options.trials))


if __name__ == "__main__":
    main()
