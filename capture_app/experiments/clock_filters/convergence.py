"""Errors of the filters after K messages: as the paper measured, and with clocks and a pace as they come."""

import random
from dataclasses import dataclass, field

from capture_app.clock import SimulatedClock
from capture_app.experiments.clock_filters.coverage import steady_times
from capture_app.experiments.clock_filters.filters import estimator_family
from capture_app.experiments.clock_filters.trials import EstimatorErrors, draw_clock
from capture_app.simulation.exchanges import START_TRUE_NS, exchanges_at
from capture_app.simulation.paper_link import PACE_NS, PAPER_LINK

COUNTS = (10, 30, 100, 300, 1000, 3000, 10_000)
_S = 1_000_000_000
WHOLE_RUN_NS = 1000 * _S
"""A window that forgets nothing."""
WINDOW_NS = 30 * _S
"""Where clocks run apart, all filters look back as far as the engine's."""


@dataclass(slots=True)
class Convergence:
    """Errors of each filter after K messages, K ascending."""

    after: dict[int, EstimatorErrors] = field(default_factory=dict)

    def mean_abs(self, name: str) -> list[float]:
        """Mean absolute errors of a filter in us, by K."""
        return [errors.mean_abs(name) for errors in self.after.values()]


@dataclass(frozen=True, slots=True)
class Setting:
    """How the messages go out, and what is known of the clocks."""

    name: str
    skewed: bool
    window_ns: int


AS_THE_PAPER = Setting("no skew, a message each 3.43 ms", skewed=False, window_ns=WHOLE_RUN_NS)
BY_DEFAULT = Setting("skews of 20 ppm, the engine's own pace", skewed=True, window_ns=WINDOW_NS)


def converge(setting: Setting, counts: tuple[int, ...], trials: int, seed: str) -> Convergence:
    """Give all filters the same messages on the paper's link, and judge them after as many as `counts`."""
    found = Convergence({count: EstimatorErrors() for count in sorted(counts)})
    for i in range(trials):
        rng = random.Random(f"{seed} {i}")
        clock = draw_clock(rng) if setting.skewed else SimulatedClock(round(rng.uniform(-36e12, 36e12)))
        family = estimator_family(setting.window_ns)
        arrived = exchanges_at(PAPER_LINK, clock, rng, _times_ns(setting, max(counts)))
        for k, message in enumerate(arrived, start=1):
            for name, estimator in family.items():
                estimator.add(message.sample)
                if k in found.after:
                    found.after[k].add(name, estimator, clock, message.arrived_true_ns)
    return found


def _times_ns(setting: Setting, count: int) -> list[int]:
    if not setting.skewed:
        return [START_TRUE_NS + i * PACE_NS for i in range(count)]
    until_ns = _S
    while len(sent_ns := steady_times(until_ns)) < count:
        until_ns *= 2
    return [START_TRUE_NS + t for t in sent_ns[:count]]
