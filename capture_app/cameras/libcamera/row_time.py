"""The row time of a sensor, from the frame durations that it reports: whole rows, cut to microseconds.

A frame lasts a whole number of rows, so durations asked for come back shorter by up to one. Which row time
makes all those that came back whole multiples of it is then a question of arithmetic.
"""

import random
from collections.abc import Iterable, Sequence
from math import ceil, floor

ASKED = 32
"""So many different durations leave no second answer, for rows of 5 us and longer."""
FEWEST = 12
"""Of fewer different ones, chance could make a row time."""
SPAN = 0.5
"""Of the frame period: asked for are durations up to so much longer."""
LONGEST_ROW_US = 250.0
SHORTEST_ROW_US = 5.0
_SEED = 1
"""Of durations at random: those at even distances could all be multiples of two rows."""
_BELOW_US, _ABOVE_US = 0.5, 1.0
"""A driver that rounds reports up to half a microsecond more than there is, one that cuts up to one less."""


def durations_to_ask_us(period_us: int, longest_us: int) -> list[int]:
    """Frame durations in us that, asked for one after the other, give the row time away."""
    span_us, rng = min(SPAN * period_us, longest_us - period_us), random.Random(_SEED)
    return [period_us + round(span_us * rng.random()) for _ in range(ASKED)]


def find_row_time_us(reported_us: Iterable[int]) -> float | None:
    """The longest row time in us of which all reported frame durations are whole multiples.

    None where there is none, or the durations are too few, or too alike, to tell.
    """
    durations = sorted(set(reported_us))
    if len(durations) < FEWEST or durations[0] <= 0:
        return None
    least_us, *others = durations
    for rows in range(ceil(least_us / LONGEST_ROW_US), floor(least_us / SHORTEST_ROW_US) + 1):
        bounds = (least_us - _BELOW_US) / rows, (least_us + _ABOVE_US) / rows
        found = _narrowed(bounds, others)
        if found is not None:
            return sum(found) / 2
    return None


def _narrowed(bounds_us: tuple[float, float], durations_us: Sequence[int]) -> tuple[float, float] | None:
    """The row times within these bounds that make all the durations whole rows; None for none."""
    low_us, high_us = bounds_us
    for at, duration_us in enumerate(durations_us):
        fewest = floor((duration_us - _BELOW_US) / high_us) + 1
        most = ceil((duration_us + _ABOVE_US) / low_us) - 1
        if fewest > most:
            return None
        if fewest < most:
            tried = (
                _narrowed(_overlap((low_us, high_us), duration_us, rows), durations_us[at + 1 :])
                for rows in range(fewest, most + 1)
            )
            return next(filter(None, tried), None)
        low_us, high_us = _overlap((low_us, high_us), duration_us, fewest)
    return (low_us, high_us) if low_us < high_us else None


def _overlap(bounds_us: tuple[float, float], duration_us: int, rows: int) -> tuple[float, float]:
    return (
        max(bounds_us[0], (duration_us - _BELOW_US) / rows),
        min(bounds_us[1], (duration_us + _ABOVE_US) / rows),
    )
