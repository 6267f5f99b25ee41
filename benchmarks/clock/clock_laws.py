"""Our clock under 28 laws of delay that no study uses: what its free numbers were chosen on (simulated).

Each trial draws a law, how long the way takes at least, how much longer on average, how unequal the two ways
are, and the clock. Prints how often the stated 95 % holds, in eight situations, and the interval score; then
the error of estimates whose least delays are lowered by shares of how far the next ones lie above them.
"""

import random
from collections.abc import Callable
from dataclasses import dataclass
from math import exp, log, sqrt
from typing import Any

from benchmarks.paper.clock_trials import (
    ASYMMETRY,
    FIRST_SECOND,
    SITUATIONS,
    Coverage,
    DrawLink,
    measure_coverage,
    unequal_links,
)
from benchmarks.report import new_parser, print_report, print_rows
from benchmarks.simulated.wifi_laws import LINKS_BY_LAW
from capture_app.common.clock import SimulatedClock
from capture_app.simulation.exchanges import exchanges
from capture_app.simulation.links import Link

Shape = Callable[[random.Random], float]
"""Draws a delay beyond the least one, on any scale."""

LEAST_NS = (50e3, 2e6)
"""Half the least round trip is drawn between these, evenly on a scale of ratios."""
LONGER = (0.2, 4.0)
"""So many times that is the mean delay longer than the least."""
UNEQUAL = 3.0
"""So many times is the one way's mean excess the other's, at most."""
ALIKE = 0.7
"""Share of the links whose two ways have one law."""
LATE, LATE_NS = 0.006, 20e6
LOOKED_AT = 24
SHARES = (0.0, 0.1, 0.2, 0.3)
PACE_NS, MESSAGES = 3_000_000, 300


def _inverse_gaussian(shape: float) -> Shape:
    """Michael, Schucany and Haas 1976; mean 1."""

    def draw(rng: random.Random) -> float:
        y = rng.gauss(0.0, 1.0) ** 2
        x = 1.0 + y / (2.0 * shape) - sqrt(4.0 * shape * y + y * y) / (2.0 * shape)
        return x if rng.random() <= 1.0 / (1.0 + x) else 1.0 / x

    return draw


def _gamma(power: float) -> Shape:
    return lambda rng: rng.gammavariate(power, 1.0)


def _lognormal(sigma: float) -> Shape:
    return lambda rng: rng.lognormvariate(0.0, sigma)


def _weibull(power: float) -> Shape:
    return lambda rng: rng.weibullvariate(1.0, power)


def _beta(power: float, other: float) -> Shape:
    return lambda rng: rng.betavariate(power, other)


def _burr(power: float, tail: float) -> Shape:
    return lambda rng: min(((1.0 - rng.random()) ** (-1.0 / tail) - 1.0) ** (1.0 / power), 50.0)


def _either(share: float, mean: float) -> Shape:
    """One of two exponentials, the quicker one with this share and mean."""
    return lambda rng: rng.expovariate(1.0 / mean if rng.random() < share else 1.0)


def _both(mean: float) -> Shape:
    """Two exponentials after each other."""
    return lambda rng: rng.expovariate(1.0) + rng.expovariate(1.0 / mean)


def _queue(busy: float, jitter: float) -> Shape:
    """A queue that is often empty."""
    return lambda rng: (
        rng.gammavariate(3.0, jitter / 3.0) + (rng.expovariate(1.0) if rng.random() < busy else 0.0)
    )


def _fast_or_slow(share: float, fast: float, slow: float) -> Shape:
    """A quick path now and then, beside a slow one."""

    def draw(rng: random.Random) -> float:
        if rng.random() < share:
            return rng.gammavariate(fast, 0.2 / fast)
        return 0.5 + rng.gammavariate(slow, 1.0 / slow)

    return draw


def _backoff(rng: random.Random) -> float:
    """Slots drawn before sending, then a service, then perhaps a retry."""
    retry = rng.expovariate(1.0) if rng.random() < 0.5 else 0.0
    return rng.randrange(16) * 0.1 + rng.gammavariate(2.0, 0.1) + retry


SHAPES: dict[str, Shape] = {
    **{f"gamma {k}": _gamma(k) for k in (0.7, 1.25, 1.75, 2.5, 4.0, 6.0)},
    **{f"lognormal {sigma}": _lognormal(sigma) for sigma in (0.45, 0.8, 1.3)},
    **{f"Weibull {k}": _weibull(k) for k in (0.8, 1.3, 1.7, 2.5)},
    **{f"inverse Gaussian {k}": _inverse_gaussian(k) for k in (1.0, 3.0)},
    **{f"beta {a}": _beta(a, b) for a, b in ((2.0, 5.0), (1.2, 3.0))},
    **{f"Burr {k}": _burr(k, tail) for k, tail in ((2.0, 2.0), (3.0, 1.5))},
    **{f"either exponential, {p}": _either(p, mean) for p, mean in ((0.3, 0.1), (0.1, 0.03))},
    **{f"both exponentials, {mean}": _both(mean) for mean in (0.1, 0.4)},
    **{f"queue {busy}": _queue(busy, jitter) for busy, jitter in ((0.7, 0.05), (0.9, 0.2))},
    **{f"fast or slow, {p}": _fast_or_slow(p, a, b) for p, a, b in ((0.15, 1.5, 2.0), (0.05, 2.0, 3.0))},
    "backoff": _backoff,
}
_rng = random.Random("means")
MEANS = {name: sum(shape(_rng) for _ in range(4000)) / 4000.0 for name, shape in SHAPES.items()}


@dataclass(frozen=True, slots=True)
class ShapedLaw:
    """One-way delay: the least, and beyond it a law of this name and mean; times in ns."""

    name: str
    least_ns: float
    excess_ns: float

    def draw(self, rng: random.Random, true_ns: int = 0) -> int:
        """Return the delay of one datagram, in ns."""
        delay_ns = self.least_ns + self.excess_ns * SHAPES[self.name](rng) / MEANS[self.name]
        return round(delay_ns + (rng.random() * LATE_NS if rng.random() < LATE else 0.0))


def drawn_link(name: str) -> DrawLink:
    """Links with this law on the way to the leader."""

    def draw(rng: random.Random) -> Link:
        half_ns = exp(rng.uniform(log(LEAST_NS[0]), log(LEAST_NS[1])))
        excess_ns = half_ns * exp(rng.uniform(log(LONGER[0]), log(LONGER[1])))
        unequal = exp(rng.uniform(-0.5, 0.5) * log(UNEQUAL))
        back = name if rng.random() < ALIKE else rng.choice(list(SHAPES))
        shift_ns = rng.gauss(0.0, ASYMMETRY) * half_ns
        return Link(
            ShapedLaw(name, half_ns + shift_ns, excess_ns * unequal),
            ShapedLaw(back, half_ns - shift_ns, excess_ns / unequal),
        )

    return draw


def interval_score(one: Coverage) -> float:
    """Mean of the width and, for each miss, 40 times what is missing, in us (Gneiting and Raftery 2007)."""
    scores = [
        2.0 * stated + 40.0 * max(0.0, abs(error) - stated)
        for stated, error in zip(one.stated_us, one.errors_us, strict=True)
    ]
    return sum(scores) / len(scores)


def corrected_errors(draw: DrawLink, count: int, seed: str) -> list[float]:
    """Mean error in us after a second of the middle of the two least delays, for each of `SHARES`.

    Each least delay is lowered by that share of how far the mean of the 24 least lies above it.
    """
    sums = [0.0] * len(SHARES)
    for i in range(count):
        rng = random.Random(f"{seed} {i}")
        clock = SimulatedClock(0, rng.gauss(0.0, 20.0), 10**12)
        messages = exchanges(draw(rng), clock, rng, count=MESSAGES, pace_ns=PACE_NS)
        true_ns = max(m.arrived_true_ns for m in messages)
        offset_ns = true_ns - clock.local_from_true(true_ns)
        above = sorted(m.sample.upper_ns - offset_ns for m in messages)[:LOOKED_AT]
        below = sorted(offset_ns - m.sample.lower_ns for m in messages)[:LOOKED_AT]
        excess_ns = [sum(least) / LOOKED_AT - least[0] for least in (above, below)]
        for k, share in enumerate(SHARES):
            sums[k] += abs(above[0] - below[0] - share * (excess_ns[0] - excess_ns[1])) / 2000.0
    return [total / count for total in sums]


def fixed(law: str) -> DrawLink:
    """The studies' link of that name, always the same."""

    def draw(_: random.Random) -> Link:
        return LINKS_BY_LAW[law]

    return draw


def main() -> None:
    """Print both tables."""
    parser = new_parser(__doc__, seed_of="all chance")
    parser.add_argument("--trials", type=int, default=40, help="trials of each law (40)")
    options = parser.parse_args()
    found = {
        name: measure_coverage(drawn_link(name), options.trials, f"{options.seed} {name}") for name in SHAPES
    }
    rows = []
    for situation in SITUATIONS:
        each = [by_situation[situation] for by_situation in found.values()]
        trials = sum(len(one.errors_us) for one in each)
        rows.append(
            {
                "situation": situation,
                "held": sum(one.held for one in each) / trials,
                "worst_law": min(one.share for one in each),
                "best_law": max(one.share for one in each),
                "score_us": exp(sum(log(interval_score(one)) for one in each) / len(each)),
                "bound_held": sum(one.bounded for one in each) / trials,
            }
        )
    many = [corrected_errors(drawn_link(name), options.trials, f"{options.seed} {name}") for name in SHAPES]
    errors_us = {
        f"{len(SHAPES)} laws": [exp(sum(log(e[k]) for e in many) / len(many)) for k in range(len(SHARES))]
    }
    for law in LINKS_BY_LAW:
        seed = f"{options.seed} {law}"
        errors_us[f"{law}, drawn"] = corrected_errors(unequal_links(law), 5 * options.trials, seed)
        errors_us[law] = corrected_errors(fixed(law), 5 * options.trials, seed)
    report = {
        "kind": "simulated",
        "laws": len(SHAPES),
        "trials": options.trials,
        "seed": options.seed,
        "coverage": rows,
        "worst_law": min(found, key=lambda name: found[name][FIRST_SECOND].share),
        "corrected_errors_us": errors_us,
    }
    print_report(report, _print, as_json=options.json)


COLUMNS = {
    "situation": ("stated 95 %", ""),
    "held": ("held", ".1%"),
    "worst_law": ("worst law", ".0%"),
    "best_law": ("best law", ".0%"),
    "score_us": ("score, us", ".1f"),
    "bound_held": ("bound held", ".2%"),
}


def _print(report: dict[str, Any]) -> None:
    print(f"{report['laws']} laws, {report['trials']} trials of each, simulated, seed {report['seed']}")
    print_rows(report["coverage"], COLUMNS)
    print(f"worst law in the {FIRST_SECOND}: {report['worst_law']}\n")
    names = [f"{share:.0%} off" for share in SHARES]
    errors = [
        {"law": law, **dict(zip(names, of_law, strict=True))}
        for law, of_law in report["corrected_errors_us"].items()
    ]
    shares = {name: (name, ".1f") for name in names}
    print_rows(errors, {"law": ("mean error, us", ""), **shares})


if __name__ == "__main__":
    main()
