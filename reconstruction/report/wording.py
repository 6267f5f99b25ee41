"""Numbers and comparisons in words that need no knowledge of cameras."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

from capture_app.text import duration
from reconstruction.report.findings import CLEAR_SHARE, DEPTH_MEASURES, first_known
from reconstruction.scores.comparison_results import CompareResult
from reconstruction.scores.timing import are_apart, are_together

NOT_AVAILABLE = "n/a"
GAP = "\u202f"
"""Narrow space that keeps a number and its unit on one line."""
WALKING_M_PER_S = 1.4
UNSYNCHRONIZED = "unsynchronized"
EACH_DELAYED = "each camera off by a different delay"
"""The condition of the studies of all cameras, in a word and in words."""


def share(value: float | None, *, decimals: int = 1) -> str:
    """Share 0..1 as a percentage; never rounds up to all or down to nothing."""
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


def quantity(value: float | None, unit: str = "") -> str:
    """A number in its unit with three digits."""
    if value is None or math.isnan(value):
        return NOT_AVAILABLE
    if abs(value) >= 10_000 and not unit:
        return number(value)
    decimals = 2 if abs(value) < 9.995 else 1 if abs(value) < 99.95 else 0
    return f"{value:.{decimals}f}{GAP}{unit}" if unit else f"{value:.{decimals}f}"


def number(value: float | None) -> str:
    """A whole number with a space between thousands."""
    return NOT_AVAILABLE if value is None else f"{value:,.0f}".replace(",", GAP)


def times(ratio: float) -> str:
    """How many times, to two digits: it is a comparison, not a measurement."""
    digits = max(0, math.floor(math.log10(ratio)) - 1) if ratio >= 1 else 0
    rounded = round(ratio / 10**digits) * 10**digits if ratio >= 10 else round(ratio, 1)
    return f"{rounded:,.0f}".replace(",", GAP) + " times" if ratio >= 10 else f"{rounded:g} times"


def milliseconds(value_ms: float) -> str:
    """A time in ms, with a decimal only if it is not 0."""
    return f"{value_ms:.1f}".removesuffix(".0") + f"{GAP}ms"


def microseconds(value_us: float | None) -> str:
    """A time in us, shown in ns, us, ms or s, whichever reads best."""
    if value_us is None or math.isnan(value_us):
        return NOT_AVAILABLE
    return duration(value_us * 1e3, gap=GAP)


def seconds(value_s: float) -> str:
    """A duration in s, in minutes from two minutes on."""
    if value_s < 120:
        return f"{value_s:.1f}{GAP}s"
    return f"{int(value_s // 60)}{GAP}min {int(value_s % 60)}{GAP}s"


def lateness(offset_ms: float) -> str:
    """`67 ms late`, or early, in whole ms from 10 ms on."""
    size = abs(offset_ms)
    shown = milliseconds(round(size) if size >= 9.5 else size)
    return f"{shown} {'early' if offset_ms < 0 else 'late'}"


def timeliness(late_ms: float) -> str:
    """`on time`, `33 ms late` or `33 ms early`."""
    return lateness(late_ms) if abs(late_ms) >= 0.05 else "on time"


def delays(late_ms: Mapping[str, float]) -> str:
    """`cam00 on time, cam01 66 ms late`."""
    return ", ".join(f"{camera} {timeliness(ms)}" for camera, ms in late_ms.items())


def describe_delays(late_ms: Mapping[str, float], reference: str) -> str:
    """How late each camera is, in a sentence; without numbers, drawn at random."""
    if not late_ms:
        return f"Unsynchronized: {EACH_DELAYED} of up to 66 ms, drawn at random for each instant."
    return f"Unsynchronized, relative to {reference}: {delays(late_ms)}."


@dataclass(frozen=True)
class Sides:
    """What the two sides of a comparison are called."""

    first: str
    short: str
    """The first side where there is little room."""
    when: str
    """The first side at the end of a sentence."""
    late: str
    late_short: str = ""
    """The second side where there is little room; empty: as elsewhere."""
    apart: bool = False
    """Whether the pictures of the first side were found not to be of one instant."""

    @property
    def late_head(self) -> str:
        """The second side at the head of a column."""
        return self.late[0].upper() + self.late[1:]

    def for_all_cameras(self) -> Self:
        """The names where each camera has a delay of its own."""
        return replace(self, late=UNSYNCHRONIZED, late_short="Unsynced")


def name_sides(result: CompareResult, cameras: Sequence[str] = ()) -> Sides:
    """The names for what is shown of these cameras; without any, of the pair whose timing was measured.

    Only pictures that were found to be of one instant are called synchronized.
    """
    pair, rig = result.timing, result.rig_timing
    asked = cameras or (() if pair is None else pair.cameras)
    late = lateness(result.actual_offset_ms)
    if asked and are_together(asked, pair, rig):
        many = "all" if len(asked) > 2 else "both"
        return Sides("Synchronized", "Synced", f"when {many} pictures show the same instant", late)
    when = "in the pictures as they were recorded"
    return Sides("As recorded", "Recorded", when, late, apart=are_apart(asked, pair, rig))


def walking_distance(offset_ms: float) -> str:
    """How far a person walks in this time, in a sentence."""
    metres = abs(offset_ms) / 1e3 * WALKING_M_PER_S
    far = f"{metres * 1e3:.0f}{GAP}mm" if metres < 0.02 else f"{metres * 1e2:.0f}{GAP}cm"
    time = lateness(offset_ms).rpartition(" ")[0]
    return f"In {time}, a person walking ({WALKING_M_PER_S}{GAP}m/s) moves {far}."


def keep_units(text: str) -> str:
    """The text with a narrow space between numbers and units, which keeps them on one line."""
    return re.sub(r"(?<=\d) (?=([mµ]?s|px|[cm]?m)\b|%)", GAP, text)


def headline(verdict: str) -> tuple[str, str]:
    """The first sentence of a verdict, and the rest."""
    verdict = keep_units(verdict)
    end = verdict.find(". ")
    return (verdict, "") if end < 0 else (verdict[: end + 1], verdict[end + 2 :].strip())


def control(result: CompareResult) -> str:
    """Whether timing alone can explain the difference: by the control, what stands still."""
    if result.stereo is None:
        return ""
    if result.timing is not None and result.timing.moving_cameras:
        return "The cameras moved while they recorded, so nothing in the pictures is a control."
    synced, offset = result.stereo.synced, result.stereo.offset
    still = first_known(synced, offset, "static_within_2pct", "static_coverage")
    if still is None:
        return ""
    values = f"({share(still[1])} and {share(still[2])})"
    if abs(still[1] - still[2]) >= 0.02:
        return (
            f"Things at rest are the control, and here they differ too {values}: not all of the difference "
            "comes from timing."
        )
    moving = first_known(synced, offset, *DEPTH_MEASURES)
    if moving is None or moving[1] - moving[2] < CLEAR_SHARE:
        return f"Things at rest are the control: they are measured equally well in both {values}."
    return (
        f"Things at rest are the control: they are measured equally well in both {values}, so the difference "
        "on moving things comes from timing alone."
    )


def synchronization(residual_us: float | None, bound_us: float | None) -> str:
    """How far images are from their instants, by the session's record."""
    parts = []
    if residual_us is not None:
        parts.append(f"every picture within {microseconds(residual_us)} of its instant")
    if bound_us is not None:
        parts.append(f"the clocks agree to {microseconds(bound_us)} in the worst case")
    return "; ".join(parts) or "not known: the session has no record of its clocks"
