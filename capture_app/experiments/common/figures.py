"""Figures that sum up errors: mean, largest, standard deviation, bias, quantiles."""

from collections.abc import Sequence
from math import nan, sqrt


def error_figures(errors: list[float]) -> dict[str, float]:
    """Return `mean_abs`, `max`, `std` and `bias` of errors, in their unit; raises ValueError for none."""
    if not errors:
        raise ValueError("no errors to sum up")
    bias = sum(errors) / len(errors)
    return {
        "mean_abs": sum(abs(e) for e in errors) / len(errors),
        "max": max(abs(e) for e in errors),
        "std": sqrt(sum((e - bias) ** 2 for e in errors) / len(errors)),
        "bias": bias,
    }


def quantile(ascending: Sequence[float], share: float) -> float:
    """The value below which that share lies; nan for none."""
    return ascending[min(len(ascending) - 1, int(share * len(ascending)))] if ascending else nan
