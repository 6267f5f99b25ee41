"""The step that measured shifts are whole multiples of: the rows of a sensor show in what moves its phase."""

from collections.abc import Sequence
from math import e, log, pi, sqrt
from statistics import fmean

LEAST_SHIFTS = 6
WIDEST_NS = 200_000.0
"""No sensor's rows take longer."""
LEAST_NOISE_NS = 500.0
"""No stamps are better, and finer steps would take long to tell apart."""
FINEST = 2.0
"""A step is looked for where it is so many times as large as the noise."""
NORMAL = sqrt(2.0 * pi * e)
"""Normal noise of 1 sd fills as much of a step, in entropy, as so many sd of even noise."""
SURE = log(100.0)
"""A step must be so much likelier (log) than the likeliest of as many that are none."""


def common_step(shifts_ns: Sequence[float], noise_ns: float) -> float | None:
    """The step of which all shifts are most likely whole multiples, but for the noise (1 sd) of each.

    None where no step is likely enough, as one that is hardly wider than the noise, or for too few shifts.
    """
    if len(shifts_ns) < LEAST_SHIFTS:
        return None
    # Differences to the least are smaller: their multiples are told from fewer candidates.
    least_ns = min(shifts_ns)
    offs = [shift - least_ns for shift in shifts_ns]
    noise_ns = max(noise_ns, LEAST_NOISE_NS)
    grain = noise_ns / max(*offs, noise_ns) / 2.0
    tried, best, best_ns = 0, 0.0, WIDEST_NS
    step_ns = WIDEST_NS
    while step_ns > FINEST * noise_ns:
        likely = log(step_ns / max(_misfit(offs, step_ns), noise_ns / 2.0))
        if likely > best:
            best, best_ns = likely, step_ns
        step_ns *= 1.0 - grain
        tried += 1
    free = len(offs) - 2
    if free * (best - log(NORMAL)) < SURE + log(max(1, tried)):
        return None
    return _refined(offs, best_ns)


def _residuals(offs_ns: Sequence[float], step_ns: float) -> list[float]:
    """How far each is off the lattice that they lie on best; the least one has noise, too."""
    first = [off - step_ns * round(off / step_ns) for off in offs_ns]
    middle = fmean(first)
    return [off - middle - step_ns * round((off - middle) / step_ns) for off in offs_ns]


def _misfit(offs_ns: Sequence[float], step_ns: float) -> float:
    return sqrt(fmean(off * off for off in _residuals(offs_ns, step_ns)))


def _refined(offs_ns: Sequence[float], step_ns: float) -> float:
    """The step by a line through the shifts, once it is known how many steps each has."""
    counts = [round(off / step_ns) for off in offs_ns]
    middle, mean_ns = fmean(counts), fmean(offs_ns)
    weight = sum((n - middle) ** 2 for n in counts)
    along = sum((n - middle) * (off - mean_ns) for n, off in zip(counts, offs_ns, strict=True))
    return along / weight if weight else step_ns
