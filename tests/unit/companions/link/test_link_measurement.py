"""Both ends of the measured link: over loopback, and step by step without a socket."""

import asyncio
import json
import random
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from capture_app.cli import run
from capture_app.common.address import Address
from capture_app.common.clock import HostClock, SimulatedClock
from capture_app.common.errors import ExitCode, NetworkError
from capture_app.companions.link import link_measurement as measuring
from capture_app.companions.link.link_measurement import (
    LinkClient,
    Synchronization,
    judge,
    serve,
    sum_up,
    synchronize,
)
from capture_app.net.server import bind_port
from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig

MS = 1_000_000
AHEAD_NS = 5_000 * MS


def free_port() -> int:
    datagrams, listening = bind_port("127.0.0.1", 0)
    port = int(datagrams.getsockname()[1])
    datagrams.close()
    listening.close()
    return port


def step(link: LinkClient, leader: Leader, *, lost: float) -> None:
    """Let both ends talk in stepped time until the client has what it wants; the leader's clock is ahead."""
    rng, client = random.Random(1), link.client
    flying: list[tuple[int, bool, bytes]] = []
    for now_ns in range(0, 20_000 * MS, MS // 4):
        for item in [f for f in flying if f[0] <= now_ns]:
            flying.remove(item)
            if item[1]:
                leader.receive_datagram(item[2], ("c", 1), now_ns + AHEAD_NS)
            else:
                client.receive_datagram(item[2], now_ns)
        if now_ns >= client.next_timer():
            client.handle_timer(now_ns)
        sent = [(True, data) for data in client.datagrams_to_send(now_ns)]
        sent += [(False, data) for data, _ in leader.datagrams_to_send(now_ns + AHEAD_NS)]
        flying += [(now_ns + MS, *item) for item in sent if rng.random() >= lost]
        link.note_events(now_ns / 1e9)
        if link.done.is_set():
            return


@pytest.mark.parametrize(("lost", "most"), [(0.0, 310), (0.3, 720)])
def test_samples_are_paced_and_losses_made_up_for(lost: float, most: int) -> None:
    link, leader = LinkClient(random.Random(1), 300, 3 * MS), Leader(LeaderConfig(1, 0), random.Random(2))
    step(link, leader, lost=lost)
    assert link.joined.is_set()
    reached = link.result
    assert reached is not None
    assert len(reached.samples) == 300
    assert 300 <= reached.requests <= most
    assert {s.round_trip_ns for s in reached.samples} == {2 * MS}
    first, last = reached.samples[0].t0_ns, reached.samples[-1].t0_ns
    assert (last - first) / MS >= 299 * 3 - 3
    assert abs(reached.time_map.leader_from_local(last) - last - AHEAD_NS) <= MS
    assert reached.seconds >= (last - first) / 1e9


def synchronization(clock: SimulatedClock, delays_ns: list[tuple[int, int]]) -> Synchronization:
    """Samples every 3 ms whose truth is known: the leader's clock is 7 ns ahead of the host's."""
    samples = []
    for i, (there_ns, back_ns) in enumerate(delays_ns):
        times_ns = (i * 3 * MS, i * 3 * MS + there_ns, i * 3 * MS + there_ns + back_ns)
        t0_ns, _, t3_ns = (clock.local_from_true(t) for t in times_ns)
        samples.append(ClockSample(t0_ns, times_ns[1] + 7, times_ns[1] + 7, t3_ns))
    engine = ClockFilter()
    for sample in samples:
        engine.add(sample)
    time_map = engine.time_map(samples[-1].t3_ns)
    assert time_map is not None
    return Synchronization(samples, time_map, seconds=0.9, requests=300)


def test_all_are_judged_at_the_last_sample() -> None:
    clock = SimulatedClock(10**12, 20.0, 0)
    delays_ns = [(200_000 + 1000 * (i % 7), 200_000 + 1000 * (i % 5)) for i in range(300)]
    trial = judge(synchronization(clock, delays_ns), clock, 7)
    assert abs(trial.error_us) < 2.0
    assert abs(trial.error_us) <= trial.uncertainty_us <= trial.hard_bound_us
    assert trial.round_trip_us == pytest.approx(400, abs=1)


@pytest.fixture
async def leader_port() -> AsyncIterator[int]:
    port = free_port()
    server = asyncio.ensure_future(serve("127.0.0.1", port))
    await asyncio.sleep(0)
    yield port
    server.cancel()


async def test_two_ends_on_this_machine(leader_port: int) -> None:
    address, link = Address("127.0.0.1", leader_port), LinkClient(random.Random(1), 300, MS)
    reached = await synchronize(address, HostClock(), link, timeout_s=60.0)
    assert len(reached.samples) >= 300
    assert reached.requests >= 300
    assert all(abs(s.upper_ns) < 10**9 and s.lower_ns <= 0 <= s.upper_ns for s in reached.samples)
    trial = judge(reached, HostClock())
    assert abs(trial.error_us) <= trial.hard_bound_us


async def test_the_command_measures_a_leader_of_this_machine(
    leader_port: int, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    pytest.importorskip("matplotlib")
    connect = ["--connect", f"127.0.0.1:{leader_port}", "--trials", "1", "--json"]
    connect += ["--plot", str(tmp_path / "figures")]
    assert await asyncio.to_thread(run, ["link", *connect]) == ExitCode.OK
    result = json.loads(capsys.readouterr().out)
    assert (result["kind"], result["trials"]) == ("real", 1)
    assert result["coverage_hard_bound"] == 1.0
    assert (tmp_path / "figures" / "link.png").stat().st_size > 10_000


async def test_nobody_at_the_other_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measuring, "JOIN_TIMEOUT_S", 0.05)
    address, link = Address("127.0.0.1", free_port()), LinkClient(random.Random(1), 300)
    with pytest.raises(NetworkError, match="--serve"):
        await synchronize(address, HostClock(), link, timeout_s=1.0)


def test_the_command_wants_one_end(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["link"]) == ExitCode.USAGE
    assert run(["link", "--serve", "--connect", "127.0.0.1:1"]) == ExitCode.USAGE
    assert "--connect" in capsys.readouterr().err


def test_the_result_of_some_trials() -> None:
    rng = random.Random(1)
    delays_ns = [
        (200_000 + round(rng.expovariate(1e-6)), 200_000 + round(rng.expovariate(1e-6))) for _ in range(300)
    ]
    clock = SimulatedClock(0)
    trial = judge(synchronization(clock, delays_ns), clock, 7)
    figures = sum_up([trial] * 3, kind="emulated link", messages=300, seed=1)
    assert (figures["kind"], figures["trials"]) == ("emulated link", 3)
    assert figures["coverage_hard_bound"] == 1.0
    figures_us = (figures["mean_abs_us"], figures["max_us"], abs(figures["bias_us"]))
    assert figures_us == pytest.approx((abs(trial.error_us),) * 3)
