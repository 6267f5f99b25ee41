"""Trials of `clock-filters`: all estimators on the same messages, and their errors."""

import random
from dataclasses import dataclass, field

from capture_app.clock import SimulatedClock
from capture_app.experiments.clock_filters.filters import ClockEstimator, estimator_family
from capture_app.experiments.common.result import error_figures
from capture_app.simulation.exchanges import exchanges
from capture_app.simulation.links import Link, ReplayedDelay

FIRST = 300
"""K of the paper, and of our engine."""
PACE_NS = 3_000_000
SKEW_PPM = 20.0
"""One sigma of the clients' skew in each trial; offsets are hours."""


@dataclass(slots=True)
class EstimatorErrors:
    """Errors of each estimator in us over all trials under one law, and how often ours held its bounds."""

    errors_us: dict[str, list[float]] = field(default_factory=dict)
    covered: int = 0
    bounded: int = 0
    uncertainties_us: list[float] = field(default_factory=list)

    def add(self, name: str, estimator: ClockEstimator, clock: SimulatedClock, true_ns: int) -> None:
        """Judge an estimator's time map at a true time in ns."""
        local_ns = clock.local_from_true(true_ns)
        time_map = estimator.time_map(local_ns)
        assert time_map is not None
        error_ns = time_map.leader_from_local(local_ns) - true_ns
        self.errors_us.setdefault(name, []).append(error_ns / 1000.0)
        if name == "ours":
            self.covered += abs(error_ns) <= time_map.uncertainty_ns
            self.bounded += abs(error_ns) <= time_map.hard_bound_ns
            self.uncertainties_us.append(time_map.uncertainty_ns / 1000.0)

    def mean_abs(self, name: str) -> float:
        """Mean absolute error of an estimator in us."""
        return error_figures(self.errors_us[name])["mean_abs"]

    @property
    def gain(self) -> float:
        """How many times smaller the mean error of ours is than the minimum filter's."""
        return self.mean_abs("minimum") / self.mean_abs("ours")


def draw_clock(rng: random.Random) -> SimulatedClock:
    """Draw a client's clock: hours of offset, SKEW_PPM of skew."""
    return SimulatedClock(round(rng.uniform(-36e12, 36e12)), rng.gauss(0.0, SKEW_PPM), 10**12)


def run_law_trials(link: Link, count: int, seed: str) -> EstimatorErrors:
    """Give all estimators the same messages in each trial, and judge them after the last one."""
    result = EstimatorErrors()
    for i in range(count):
        rng = random.Random(f"{seed} {i}")
        law, pace_ns = link, PACE_NS
        if isinstance(link.to_leader, ReplayedDelay) and isinstance(link.to_client, ReplayedDelay):
            start = rng.randrange(len(link.to_leader.delays_ns))
            there, back = link.to_leader, link.to_client
            pace_ns = there.every_ns
            law = Link(
                ReplayedDelay(there.delays_ns, pace_ns, start), ReplayedDelay(back.delays_ns, pace_ns, start)
            )
        clock = draw_clock(rng)
        messages = exchanges(law, clock, rng, count=FIRST, pace_ns=pace_ns)
        family = estimator_family()
        for message in messages:
            for estimator in family.values():
                estimator.add(message.sample)
        true_ns = max(message.arrived_true_ns for message in messages)
        for name, estimator in family.items():
            result.add(name, estimator, clock, true_ns)
    return result
