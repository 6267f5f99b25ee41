"""Both ends of the measured link: over loopback, and step by step without a socket."""

import asyncio
import json
import random

import pytest

from capture_app.cli import run
from capture_app.clock import HostClock, SimulatedClock
from capture_app.errors import ExitCode, NetworkError
from capture_app.experiments.link.ends import LinkProbe, SamplingClient, serve
from capture_app.experiments.link.experiment import LinkOptions, judge
from capture_app.net.address import Address
from capture_app.net.transfer import bind
from capture_app.sync.clock.clock_sample import ClockSample
from capture_app.sync.rig.leader import Leader, LeaderConfig

MS = 1_000_000


def free_port() -> int:
    datagrams, listening = bind("127.0.0.1", 0)
    port = int(datagrams.getsockname()[1])
    datagrams.close()
    listening.close()
    return port


def step(
    client: SamplingClient, leader: Leader, *, seconds: float, lost: float = 0.0, delay_ns: int = MS
) -> None:
    """Let both ends talk in stepped time; the client's clock is 5 s behind the leader's."""
    rng = random.Random(1)
    flying: list[tuple[int, bool, bytes]] = []
    for now_ns in range(0, int(seconds * 1e9), MS // 4):
        for item in [f for f in flying if f[0] <= now_ns]:
            flying.remove(item)
            if item[1]:
                leader.receive_datagram(item[2], ("c", 1), now_ns + 5_000 * MS)
            else:
                client.receive_datagram(item[2], now_ns)
        due_ns = client.next_timer()
        if due_ns is not None and now_ns >= due_ns:
            client.handle_timer(now_ns)
        sent = [(True, data) for data in client.datagrams_to_send(now_ns)]
        sent += [(False, data) for data, _ in leader.datagrams_to_send(now_ns + 5_000 * MS)]
        flying += [(now_ns + delay_ns, *item) for item in sent if rng.random() >= lost]


@pytest.mark.parametrize(("lost", "most"), [(0.0, 32), (0.3, 120)])
def test_samples_are_paced_and_losses_made_up_for(lost: float, most: int) -> None:
    client, leader = SamplingClient(random.Random(1)), Leader(LeaderConfig(1, 0), random.Random(2))
    client.begin(0, 0, 0)
    step(client, leader, seconds=1.0, lost=lost)
    assert client.joined.is_set()
    client.begin(30, 3 * MS, 0)
    step(client, leader, seconds=1.0, lost=lost)
    assert client.done.is_set()
    assert len(client.samples) == 30
    assert 30 <= client.sent <= most
    assert {s.round_trip_ns for s in client.samples} == {2 * MS}
    assert client.next_timer() is None
    first, last = client.samples[0].t0_ns, client.samples[-1].t0_ns
    assert (last - first) / MS >= 29 * 3 - 3


def test_the_family_is_judged_at_the_last_sample() -> None:
    clock = SimulatedClock(10**12, 20.0, 0)
    options = LinkOptions(Address("x", 1), true_offset_ns=7, clock=clock)
    samples = []
    for i in range(300):
        there_ns, back_ns = 200_000 + 1000 * (i % 7), 200_000 + 1000 * (i % 5)
        times_ns = (i * 3 * MS, i * 3 * MS + there_ns, i * 3 * MS + there_ns + back_ns)
        t0_ns, _, t3_ns = (clock.local_from_true(t) for t in times_ns)
        samples.append(ClockSample(t0_ns, times_ns[1] + 7, times_ns[1] + 7, t3_ns))
    trial = judge(options, samples, 0.9, 300)
    assert abs(trial.errors_us["ours"]) < 2.0
    assert abs(trial.errors_us["ours"]) <= trial.uncertainty_us <= trial.hard_bound_us
    assert trial.round_trip_us == pytest.approx(400, abs=1)


async def test_two_ends_on_this_machine() -> None:
    port = free_port()
    server = asyncio.ensure_future(serve("127.0.0.1", port))
    try:
        await asyncio.sleep(0)
        async with LinkProbe(Address("127.0.0.1", port), HostClock(), random.Random(1)) as probe:
            samples, _, sent = await probe.round(20, MS, 10.0)
    finally:
        server.cancel()
    assert len(samples) == 20 <= sent
    assert all(abs(s.upper_ns) < 10**9 and s.lower_ns <= 0 <= s.upper_ns for s in samples)


async def test_nobody_at_the_other_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("capture_app.experiments.link.ends.JOIN_TIMEOUT_S", 0.05)
    probe = LinkProbe(Address("127.0.0.1", free_port()), HostClock(), random.Random(1))
    with pytest.raises(NetworkError, match="--serve"):
        await probe.__aenter__()


def test_the_command_wants_one_end(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["experiment", "link"]) == ExitCode.USAGE
    assert run(["experiment", "link", "--serve", "--connect", "127.0.0.1:1"]) == ExitCode.USAGE
    assert "--connect" in capsys.readouterr().err


def test_the_result_of_a_real_link(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    async def measure(*_: object) -> list[object]:
        rng = random.Random(1)
        samples = []
        for i in range(300):
            there_ns, back_ns = (200_000 + round(rng.expovariate(1e-6)) for _ in range(2))
            samples.append(
                ClockSample(i * MS, i * MS + there_ns, i * MS + there_ns, i * MS + there_ns + back_ns)
            )
        return [judge(LinkOptions(Address("x", 1)), samples, 0.9, 300)] * 3

    monkeypatch.setattr("capture_app.experiments.link.experiment._measure", measure)
    assert run(["experiment", "link", "--connect", "127.0.0.1:9", "--emulated", "--json"]) == ExitCode.OK
    result = json.loads(capsys.readouterr().out)
    assert (result["kind"], result["trials"]) == ("emulated link", 3)
    assert result["ours"]["coverage_hard_bound"] == 1.0
    assert result["baseline"]["mean"]["error_us"]["mean_abs"] > result["ours"]["error_us"]["mean_abs"]
