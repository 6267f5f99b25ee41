"""Numbers and comparisons in words that need no knowledge of cameras."""

import math
import re
from collections.abc import Mapping

from capture_app.common.text import duration

NOT_AVAILABLE = "n/a"
GAP = "\u202f"
"""Narrow space that prevents a line break between a number and its unit."""
WALKING_M_PER_S = 1.4
PERCENT, PIXELS, COUNT, DEGREES, PLAIN = "%", "px", "count", "°", ""
"""Units of the measures."""


def measured(value: float | None, unit: str) -> str:
    """Format a value with its unit."""
    if unit == PERCENT:
        return percentage(value)
    if unit == COUNT:
        return number(value)
    if unit == DEGREES and value is not None:
        return f"{value:.{3 if value >= 1 else 2}g}°"
    return quantity(value, unit)


def percentage(value: float | None, *, decimals: int = 1) -> str:
    """Return a fraction 0..1 as a percentage; it is never rounded up to 100 or down to 0."""
    if value is None or math.isnan(value):
        return NOT_AVAILABLE
    percent = 100 * value
    if 0 < percent < 0.1:
        return f"under 0.1{GAP}%"
    if 0 < percent < 1 or 99 < percent < 100:
        decimals = 1
    if 99 < percent < 100:
        percent = math.floor(percent * 10) / 10
    return f"{percent:.{decimals}f}{GAP}%"


def percent(fraction: float) -> str:
    """Return a fraction 0..1 as a whole percentage for a sentence."""
    return f"{100 * fraction:.0f} %" if fraction >= 0.01 or fraction == 0 else "under 1 %"


def quantity(value: float | None, unit: str = "") -> str:
    """Return a number in its unit with three digits."""
    if value is None or math.isnan(value):
        return NOT_AVAILABLE
    if abs(value) >= 10_000 and not unit:
        return number(value)
    decimals = 2 if abs(value) < 9.995 else 1 if abs(value) < 99.95 else 0
    return f"{value:.{decimals}f}{GAP}{unit}" if unit else f"{value:.{decimals}f}"


def number(value: float | None) -> str:
    """Return a whole number with a space between thousands."""
    return NOT_AVAILABLE if value is None else f"{value:,.0f}".replace(",", GAP)


def times(ratio: float) -> str:
    """Return a ratio as `12 times`, to two digits: it is a comparison, not a measurement."""
    if ratio < 10:
        return f"{round(ratio, 1):g} times"
    digits = math.floor(math.log10(ratio)) - 1
    return f"{number(round(ratio / 10**digits) * 10**digits)} times"


def milliseconds(value_ms: float) -> str:
    """Return a time in ms, with a decimal only if it is not 0."""
    return f"{value_ms:.1f}".removesuffix(".0") + f"{GAP}ms"


def microseconds(value_us: float | None) -> str:
    """Return a time given in us as ns, us, ms or s, whichever is most readable."""
    known = value_us is not None and not math.isnan(value_us)
    return duration((value_us or 0.0) * 1e3, gap=GAP) if known else NOT_AVAILABLE


def seconds(value_s: float) -> str:
    """Return a duration in s, or in minutes from two minutes on."""
    minutes, rest_s = divmod(int(value_s), 60)
    return f"{value_s:.1f}{GAP}s" if value_s < 120 else f"{minutes}{GAP}min {rest_s}{GAP}s"


def offset_text(offset_ms: float) -> str:
    """Return `67 ms late`, or early, in whole ms from 10 ms on."""
    size = abs(offset_ms)
    size = round(size) if size >= 9.5 else size
    return f"{milliseconds(size)} {'early' if offset_ms < 0 else 'late'}"


def late_or_early(late_ms: float, uncertainty_ms: float) -> str:
    """Return `0.4 ± 0.6 ms late`, or early."""
    return f"{abs(late_ms):.1f} ± {uncertainty_ms:.1f} ms {'early' if late_ms < 0 else 'late'}"


def timeliness(late_ms: float) -> str:
    """Return `on time`, `33 ms late` or `33 ms early`."""
    return offset_text(late_ms) if abs(late_ms) >= 0.05 else "on time"


def delays(late_ms: Mapping[str, float]) -> str:
    """Return `cam00 on time, cam01 66 ms late`."""
    return ", ".join(f"{camera} {timeliness(ms)}" for camera, ms in late_ms.items())


def walking_distance(offset_ms: float) -> str:
    """Return the distance that a person walks in this time, as a sentence."""
    millimetres = abs(offset_ms) * WALKING_M_PER_S
    far = f"{millimetres:.0f}{GAP}mm" if millimetres < 20 else f"{millimetres / 10:.0f}{GAP}cm"
    return (
        f"In {offset_text(offset_ms).rpartition(' ')[0]}, a person walking ({WALKING_M_PER_S}{GAP}m/s) "
        f"moves {far}."
    )


def keep_units(text: str) -> str:
    """Return the text with a narrow space between numbers and units, so that no line breaks there."""
    return re.sub(r"(?<=\d) (?=([mµ]?s|px|[cm]?m)\b|%)", GAP, text)


def headline(verdict: str) -> tuple[str, list[str]]:
    """Return the first sentence of a verdict, and the others."""
    first, *others = re.split(r"(?<=\.) ", keep_units(verdict).strip())
    return first, others
