"""Clock errors over a link: trials of the engine's own client, and their statistics."""

import asyncio
import random
from collections.abc import AsyncIterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from statistics import fmean, pstdev
from typing import Any, Literal

from msgspec import Struct

from capture_app.common import system
from capture_app.common.address import Address, resolve
from capture_app.common.clock import HostClock, NodeClock
from capture_app.common.errors import NetworkError
from capture_app.common.timeouts import JOIN_TIMEOUT_S
from capture_app.net.server import bind_port
from capture_app.net.udp import Pump, SinglePeerEngine, client_socket
from capture_app.sync.clock.clock_filter import ClockSample
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.rig.events import Joined, LeaderNotice
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.timekeeping.poll_schedule import POLL_INTERVAL_NS, SteadySchedule
from capture_app.sync.timekeeping.timekeeper import Timekeeper

TRIALS = 10
Kind = Literal["simulated", "emulated link", "real"]


@dataclass(frozen=True, slots=True)
class Synchronization:
    """A client's estimate of its leader's clock once it has enough samples.

    `time_map` is the engine's own estimate at that moment, `seconds` the time since the client joined.
    """

    samples: list[ClockSample]
    time_map: TimeMap
    seconds: float
    requests: int


class LinkTrial(Struct, frozen=True, kw_only=True):
    """The clock at the end of one trial: its true error, and the engine's stated bounds."""

    error_us: float
    uncertainty_us: float
    hard_bound_us: float
    seconds: float
    requests: int
    round_trip_us: float
    """Minimum round trip of the trial."""


async def serve(host: str, port: int) -> None:
    """Answer clients as a leader does, until cancelled. Raises NetworkError."""
    datagrams, listening = bind_port(host, port)
    listening.close()
    leader = Leader(LeaderConfig(random.getrandbits(32), 0), random.Random())

    def drain() -> None:
        list(iter(leader.next_event, None))

    with closing(Pump(leader, HostClock(), drain)) as pump:
        pump.start(datagrams)
        await asyncio.Event().wait()


class LinkClient:
    """Node without a camera, which joins a leader and collects clock samples until it has enough."""

    def __init__(self, rng: random.Random, messages: int, poll_interval_ns: int | None = None) -> None:
        """Without `poll_interval_ns` it sends requests at the engine's own intervals."""
        self.joined = asyncio.Event()
        self.done = asyncio.Event()
        self.problem = ""
        self.samples: list[ClockSample] = []
        self.result: Synchronization | None = None
        schedule = (
            SteadySchedule()
            if poll_interval_ns is None
            else SteadySchedule(
                first_interval_ns=poll_interval_ns, easing_intervals_ns=(), poll_interval_ns=poll_interval_ns
            )
        )
        instance = rng.getrandbits(32)
        self.timekeeper = Timekeeper(rng.getrandbits(31), schedule, samples=self.samples)
        self.client = TimeClient(f"link-{instance:08x}", instance, self.timekeeper)
        self._messages = messages

    def note_events(self, now_s: float) -> None:
        """Process the client's events; call it after each step, with `now_s` of any steady clock."""
        while (event := self.client.next_event()) is not None:
            match event:
                case Joined():
                    self._joined_s = now_s
                    self.joined.set()
                case LeaderNotice("refused" | "lost"):
                    self.problem = event.text
                    if event.what == "lost":
                        self.done.set()
        keeper, time_map = self.timekeeper, self.timekeeper.time_map
        enough = len(self.samples) >= self._messages and keeper.synced
        if enough and time_map is not None and self.result is None:
            self.result = Synchronization(
                list(self.samples), time_map, seconds=now_s - self._joined_s, requests=keeper.requests
            )
            self.done.set()


async def synchronize(
    address: Address,
    clock: NodeClock,
    link: LinkClient,
    *,
    timeout_s: float,
) -> Synchronization:
    """Join the leader at an address, take the samples, and leave. Raises NetworkError."""
    family, peer = await resolve(address)
    pump = Pump(SinglePeerEngine(link.client, peer), clock, lambda: link.note_events(system.monotonic_s()))
    pump.start(client_socket(family))
    try:
        await asyncio.wait_for(link.joined.wait(), JOIN_TIMEOUT_S)
        await asyncio.wait_for(link.done.wait(), timeout_s)
    except TimeoutError:
        if link.joined.is_set():
            what = f"only {len(link.samples)} replies from {address} in {timeout_s:g} s"
            hint = "the link loses most messages: check its signal with capture-app doctor"
        elif link.problem:
            what = f"{address} refused this client: {link.problem}"
            hint = f"see capture-app doctor --leader {address}"
        else:
            what, hint = f"no answer from {address}", "start the other end with `capture-app link --serve`"
        raise NetworkError(what, hint=hint) from None
    finally:
        link.client.leave()
        pump.turn()
        pump.close()
    if link.result is None:
        raise NetworkError(
            f"the leader at {address} was lost: {link.problem}",
            hint="check that `capture-app link --serve` still runs there",
        )
    return link.result


async def measure(
    address: Address,
    clock: NodeClock,
    *,
    messages: int,
    poll_interval_ns: int | None = None,
    trials: int = TRIALS,
    seed: int,
) -> AsyncIterator[Synchronization]:
    """Let a client join again for each trial, and yield its estimate at the end.

    The other end runs `serve`. A client sends a request every `poll_interval_ns`, or at the engine's own
    intervals; `clock` is this end's, perhaps simulated. Raises NetworkError.
    """
    rng = random.Random(f"{seed} link")
    timeout_s = (
        10.0 + 5.0 * messages * (POLL_INTERVAL_NS if poll_interval_ns is None else poll_interval_ns) / 1e9
    )
    for _ in range(trials):
        yield await synchronize(
            address, clock, LinkClient(rng, messages, poll_interval_ns), timeout_s=timeout_s
        )
        # A link may be slower at first, so it idles between two trials.
        await asyncio.sleep(0.25)


def judge(reached: Synchronization, clock: NodeClock, true_offset_ns: int = 0) -> LinkTrial:
    """Compare the engine's map with the truth at the last sample.

    `clock` is the client's own, `true_offset_ns` the leader's clock minus true time.
    """
    local_ns = max(sample.t3_ns for sample in reached.samples)
    true_ns = clock.true_from_local(local_ns) + true_offset_ns
    time_map = reached.time_map
    return LinkTrial(
        error_us=(time_map.leader_from_local(local_ns) - true_ns) / 1000.0,
        uncertainty_us=time_map.uncertainty_at(local_ns) / 1000.0,
        hard_bound_us=time_map.hard_bound_at(local_ns) / 1000.0,
        seconds=reached.seconds,
        requests=reached.requests,
        round_trip_us=time_map.round_trip_ns / 1000.0,
    )


def sum_up(trials: Sequence[LinkTrial], *, kind: Kind, messages: int, seed: int) -> dict[str, Any]:
    """Return the statistics of trials of `messages` messages each; errors are estimated minus true time.

    A coverage is the fraction of the trials whose error is within the stated uncertainty, or hard bound.
    """
    errors_us = [trial.error_us for trial in trials]
    return {
        "kind": kind,
        "seed": seed,
        "messages": messages,
        "trials": len(trials),
        "mean_abs_us": fmean(map(abs, errors_us)),
        "max_us": max(map(abs, errors_us)),
        "std_us": pstdev(errors_us),
        "bias_us": fmean(errors_us),
        "seconds_mean": fmean(trial.seconds for trial in trials),
        "seconds_max": max(trial.seconds for trial in trials),
        "sent_mean": fmean(trial.requests for trial in trials),
        "min_round_trip_us": min(trial.round_trip_us for trial in trials),
        "uncertainty_us": fmean(trial.uncertainty_us for trial in trials),
        "coverage_95": fmean(abs(trial.error_us) <= trial.uncertainty_us for trial in trials),
        "coverage_hard_bound": fmean(abs(trial.error_us) <= trial.hard_bound_us for trial in trials),
    }
