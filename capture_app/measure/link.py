"""The engine's own client on a real or a recorded link, beside other filters on the same samples."""

import asyncio
import random
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

from capture_app.common.address import Address, resolve
from capture_app.common.clock import HostClock, NodeClock, SimulatedClock
from capture_app.common.errors import NetworkError
from capture_app.measure.clock_estimators import estimator_family
from capture_app.measure.result import Figures, Kind, Outcome, Result, Table, error_figures, new_figure, save
from capture_app.net.server import bind_port
from capture_app.net.udp import Pump, SinglePeerEngine, client_socket
from capture_app.simulation.exchanges import START_TRUE_NS, exchanges, read_trace
from capture_app.simulation.links import Link, ReplayedDelay
from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.rig.events import Joined, LeaderNews
from capture_app.sync.rig.leader import Leader, LeaderConfig
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.timekeeping.poll_schedule import PACE_NS, SteadySchedule
from capture_app.sync.timekeeping.timekeeper import Timekeeper

JOIN_TIMEOUT_S = 10.0


async def serve(host: str, port: int) -> None:
    """Answer clients as a leader does, until cancelled. Raises NetworkError."""
    datagrams, listening = bind_port(host, port)
    listening.close()
    leader = Leader(LeaderConfig(random.getrandbits(32), 0), random.Random())

    def drain() -> None:
        while leader.next_event() is not None:
            pass

    pump = Pump(leader, HostClock(), drain)
    pump.start(datagrams)
    try:
        await asyncio.Event().wait()
    finally:
        pump.close()


@dataclass(frozen=True, slots=True)
class Synchronization:
    """What a client has of its leader's clock once it has seen so many samples.

    `time_map` is the engine's own estimate at that moment, `seconds` the time since the client had joined.
    """

    samples: list[ClockSample]
    time_map: TimeMap
    seconds: float
    requests: int


class LinkClient:
    """A node without a camera, from joining on until it has enough samples; `client` is the engine's own."""

    def __init__(self, rng: random.Random, messages: int, pace_ns: int | None = None) -> None:
        """Without `pace_ns` it asks as the engine does by itself."""
        self.joined = asyncio.Event()
        self.done = asyncio.Event()
        self.problem = ""
        self.samples: list[ClockSample] = []
        self.result: Synchronization | None = None
        schedule = SteadySchedule()
        if pace_ns is not None:
            schedule = SteadySchedule(first_pace_ns=pace_ns, easing_paces_ns=(), pace_ns=pace_ns)
        instance = rng.getrandbits(32)
        self.timekeeper = Timekeeper(rng.getrandbits(31), schedule, samples=self.samples)
        self.client = TimeClient(f"link-{instance:08x}", instance, self.timekeeper)
        self._messages = messages
        self._joined_s = 0.0

    def note_events(self, now_s: float) -> None:
        """Look at what has happened; `now_s` is any clock that runs evenly. Call it after each step."""
        while (event := self.client.next_event()) is not None:
            match event:
                case Joined():
                    self._joined_s = now_s
                    self.joined.set()
                case LeaderNews("refused" | "lost"):
                    self.problem = event.text
                    if event.what == "lost":
                        self.done.set()
                case _:
                    pass
        time_map = self.timekeeper.time_map
        if len(self.samples) < self._messages or not self.timekeeper.synced or time_map is None:
            return
        if self.result is None:
            requests, seconds = self.timekeeper.requests, now_s - self._joined_s
            self.result = Synchronization(list(self.samples), time_map, seconds, requests)
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
    pump = Pump(SinglePeerEngine(link.client, peer), clock, lambda: link.note_events(time.monotonic()))
    pump.start(client_socket(family))
    try:
        await asyncio.wait_for(link.joined.wait(), JOIN_TIMEOUT_S)
        await asyncio.wait_for(link.done.wait(), timeout_s)
    except TimeoutError:
        if link.joined.is_set():
            raise NetworkError(
                f"only {len(link.samples)} replies from {address} in {timeout_s:g} s"
            ) from None
        if link.problem:
            raise NetworkError(f"{address} refused this client: {link.problem}") from None
        raise NetworkError(
            f"nobody answers at {address}",
            hint="start the other end with `capture-app link --serve`",
        ) from None
    finally:
        link.client.leave()
        pump.turn()
        pump.close()
    if link.result is None:
        raise NetworkError(f"the leader at {address} was lost: {link.problem}")
    return link.result


TRIALS, REPLAYED_TRIALS = 10, 100
GAP_S = 0.25
"""Between two trials the link is idle for so long: it may be slower at first."""
PAPER = {"mean": {"error_us": {"bias": 400.0}}, "minimum": {"error_us": {"bias": 19.0}}}
"""Errors of its filters after 10,000 messages: Ansari, Wadhwa, Garg and Chen 2019, supplement, figure 2."""
REPLAYED_SKEW_PPM = 20.0
"""One sigma of the simulated clocks' skew on a recorded link; offsets are hours."""


@dataclass(frozen=True, slots=True)
class Trial:
    """Errors of each estimator in us at the end of one trial, and what ours claims."""

    errors_us: dict[str, float]
    uncertainty_us: float
    hard_bound_us: float
    seconds: float
    sent: int
    round_trip_us: float


def replay(recording: Path, messages: int, *, trials: int | None, seed: int) -> Outcome:
    """Let simulated clocks synchronize over a recorded link, each from a random place of it on.

    The recording is a CSV as `read_trace` reads it, and says how fast messages follow. Raises BadInputError.
    """
    link = read_trace(recording, random.Random(f"{seed} trace"))
    there, back = link.to_leader, link.to_client
    assert isinstance(there, ReplayedDelay)
    assert isinstance(back, ReplayedDelay)
    done = []
    for i in range(trials or REPLAYED_TRIALS):
        rng = random.Random(f"{seed} recorded {i}")
        start = rng.randrange(len(there.delays_ns))
        part = Link(replace(there, start=start), replace(back, start=start))
        clock = SimulatedClock(round(rng.uniform(-36e12, 36e12)), rng.gauss(0.0, REPLAYED_SKEW_PPM), 10**12)
        heard = exchanges(part, clock, rng, count=messages, pace_ns=there.every_ns)
        engine = ClockFilter()
        for message in heard:
            engine.add(message.sample)
        time_map = engine.time_map(heard[-1].sample.t3_ns)
        assert time_map is not None
        seconds = (heard[-1].arrived_true_ns - START_TRUE_NS) / 1e9
        samples = [message.sample for message in heard]
        done.append(judge(Synchronization(samples, time_map, seconds, messages), clock))
    return report(done, "simulated", messages, seed)


def report(done: list[Trial], kind: Kind, messages: int, seed: int) -> Outcome:
    """Sum up trials of so many messages each."""
    result = _result(done, kind, messages, seed)
    notes = (
        f"{messages} messages in {median(t.seconds for t in done):.2f} s (median; slowest "
        f"{max(t.seconds for t in done):.2f} s), least round trip "
        f"{min(t.round_trip_us for t in done):.0f} us.",
        f"Stated 95 % held in {100 * result.ours['coverage_95']:.0f} % of the trials, the hard bound in "
        f"{100 * result.ours['coverage_hard_bound']:.0f} %.",
    )
    return Outcome(result, (_table(done),), notes, lambda folder: [_draw(done, folder / "link.png")])


async def measure(
    address: Address,
    clock: NodeClock,
    *,
    messages: int,
    pace_ns: int | None,
    true_offset_ns: int,
    kind: Kind,
    trials: int | None,
    seed: int,
    talk: Callable[[str], None],
) -> Outcome:
    """Let clients join anew for each trial, until they have so many samples; the other end runs `serve`.

    They ask as the engine does by itself, or each `pace_ns`. `true_offset_ns` is the leader's clock minus the
    host clock of this process, which is known where both share one kernel; `clock` is this end's own, perhaps
    simulated. Raises NetworkError.
    """
    done: list[Trial] = []
    rng = random.Random(f"{seed} link")
    timeout_s = 10.0 + 5.0 * messages * (PACE_NS if pace_ns is None else pace_ns) / 1e9
    wanted = trials or TRIALS
    for i in range(wanted):
        link = LinkClient(rng, messages, pace_ns)
        reached = await synchronize(address, clock, link, timeout_s=timeout_s)
        done.append(judge(reached, clock, true_offset_ns))
        if (i + 1) % 10 == 0 or messages > 1000:
            talk(f"{i + 1} of {wanted}: ours {done[-1].errors_us['ours']:+.1f} us")
        await asyncio.sleep(GAP_S)
    return report(done, kind, messages, seed)


def judge(reached: Synchronization, clock: NodeClock, true_offset_ns: int = 0) -> Trial:
    """Compare the engine's map, and others from the same samples, with the truth when the last one came.

    `clock` is the client's own, `true_offset_ns` the leader's clock minus true time.
    """
    others = {name: estimator for name, estimator in estimator_family().items() if name != "ours"}
    for sample in reached.samples:
        for estimator in others.values():
            estimator.add(sample)
    local_ns = max(sample.t3_ns for sample in reached.samples)
    true_ns = clock.true_from_local(local_ns) + true_offset_ns
    ours = reached.time_map
    maps = {name: estimator.time_map(local_ns) for name, estimator in others.items()} | {"ours": ours}
    errors_us = {
        name: (time_map.leader_from_local(local_ns) - true_ns) / 1000.0
        for name, time_map in maps.items()
        if time_map is not None
    }
    return Trial(
        errors_us=errors_us,
        uncertainty_us=ours.uncertainty_at(local_ns) / 1000.0,
        hard_bound_us=ours.hard_bound_at(local_ns) / 1000.0,
        seconds=reached.seconds,
        sent=reached.requests,
        round_trip_us=ours.round_trip_ns / 1000.0,
    )


def _result(trials: list[Trial], kind: Kind, messages: int, seed: int) -> Result:
    def errors(name: str) -> Figures:
        return error_figures([trial.errors_us[name] for trial in trials])

    ours = errors("ours")
    names = [name for name in trials[0].errors_us if name != "ours"]
    inside = [abs(t.errors_us["ours"]) <= t.uncertainty_us for t in trials]
    bounded = [abs(t.errors_us["ours"]) <= t.hard_bound_us for t in trials]
    return Result(
        name="link",
        kind=kind,
        seed=seed,
        trials=len(trials),
        ours={
            "error_us": ours,
            "seconds_mean": sum(t.seconds for t in trials) / len(trials),
            "seconds_max": max(t.seconds for t in trials),
            "messages": messages,
            "sent_mean": sum(t.sent for t in trials) / len(trials),
            "least_round_trip_us": min(t.round_trip_us for t in trials),
            "uncertainty_us": sum(t.uncertainty_us for t in trials) / len(trials),
            "coverage_95": sum(inside) / len(trials),
            "coverage_hard_bound": sum(bounded) / len(trials),
            "share_of_minimum": ours["mean_abs"] / max(errors("minimum")["mean_abs"], 1e-9),
        },
        baseline={name: {"error_us": errors(name)} for name in names},
        paper=PAPER,
    )


def _table(trials: list[Trial]) -> Table:
    rows = []
    for name in trials[0].errors_us:
        figures = error_figures([trial.errors_us[name] for trial in trials])
        cells = (f"{figures[key]:.2f}" for key in ("mean_abs", "max", "std", "bias"))
        rows.append((name.replace("_", " "), *cells))
    return Table(("error, us", "mean abs", "largest", "std", "bias"), rows)


def _draw(trials: list[Trial], path: Path) -> Path:
    figure = new_figure(figsize=(8, 5))
    axes = figure.subplots()
    for name in ("minimum", "per_direction_minimum", "ours"):
        axes.plot([t.errors_us[name] for t in trials], "o", ms=3, label=name.replace("_", " "))
    axes.set(xlabel="trial", ylabel="error, us", title=f"{len(trials)} trials on this link")
    axes.legend()
    return save(figure, path)
