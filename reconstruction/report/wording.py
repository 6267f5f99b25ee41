"""Numbers and comparisons in words that need no knowledge of cameras."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

from capture_app.text import duration
from reconstruction.report.verdict import CLEAR_SHARE, together
from reconstruction.scores.compare_results import CompareResult
from reconstruction.scores.depth_results import DepthScores

NOT_AVAILABLE = "n/a"
GAP = "\u202f"
"""Narrow space that keeps a number and its unit on one line."""
WALKING_M_PER_S = 1.4
APART = "apart"
"""What a condition with every camera off by another time is called."""


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
    """A number in its unit with about three digits."""
    if value is None or math.isnan(value):
        return NOT_AVAILABLE
    if abs(value) >= 10_000 and not unit:
        return number(value)
    decimals = 2 if abs(value) < 9.995 else 1 if abs(value) < 99.95 else 0
    return f"{value:.{decimals}f}{GAP}{unit}" if unit else f"{value:.{decimals}f}"


def number(value: float | None) -> str:
    """A whole number, its thousands apart."""
    return NOT_AVAILABLE if value is None else f"{value:,.0f}".replace(",", GAP)


def milliseconds(value_ms: float) -> str:
    """A time in ms, with one decimal only where it says something."""
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


def count(number: int, thing: str) -> str:
    """`1 frame`, `2 frames`."""
    return f"{number} {thing}" if abs(number) == 1 else f"{number} {thing}s"


def lateness(offset_ms: float) -> str:
    """`67 ms late`, or early; how exactly is told elsewhere."""
    size = abs(offset_ms)
    shown = milliseconds(round(size) if size >= 9.5 else size)
    return f"{shown} {'early' if offset_ms < 0 else 'late'}"


def timeliness(late_ms: float) -> str:
    """`on time`, `33 ms late` or `33 ms early`."""
    return lateness(late_ms) if abs(late_ms) >= 0.05 else "on time"


def offsets(late_ms: Mapping[str, float]) -> str:
    """`cam00 on time, cam01 66 ms late`."""
    return ", ".join(f"{camera} {timeliness(ms)}" for camera, ms in late_ms.items())


def how_apart(late_ms: Mapping[str, float], reference: str) -> str:
    """How far the cameras are apart in time, in a sentence; without offsets, they are drawn."""
    if not late_ms:
        return "Apart: every camera is off by another time, up to 66 ms, drawn for each instant."
    return f"Apart, against {reference}: {offsets(late_ms)}."


@dataclass(frozen=True)
class Sides:
    """What the two sides of a comparison are called."""

    first: str
    short: str
    """The first side where there is little room."""
    when: str
    """The first side at the end of a sentence."""
    late: str
    together: bool = True
    """The first side can be of one instant."""

    @property
    def late_head(self) -> str:
        """The second side at the head of a column."""
        return self.late[0].upper() + self.late[1:]

    def all_apart(self) -> Self:
        """The names where every camera is off by another time."""
        return replace(self, late=APART)


def sides(synced: DepthScores | None, offset_ms: float) -> Sides:
    """The names; what is plainly not of one instant is not called synchronized."""
    late = lateness(offset_ms)
    if synced is not None and not together(synced):
        return Sides("As recorded", "Recorded", "in the pictures as they were recorded", late, False)
    return Sides("Synchronized", "Synced", "when both pictures show the same instant", late)


def walk(offset_ms: float) -> str:
    """How far somebody walks meanwhile."""
    metres = abs(offset_ms) / 1e3 * WALKING_M_PER_S
    far = f"{metres * 1e3:.0f}{GAP}mm" if metres < 0.02 else f"{metres * 1e2:.0f}{GAP}cm"
    time = lateness(offset_ms).rpartition(" ")[0]
    return f"In {time}, somebody walking ({WALKING_M_PER_S}{GAP}m/s) moves {far}."


def tie(text: str) -> str:
    """The text with its numbers and their units kept on one line."""
    return re.sub(r"(?<=\d) (?=([mµ]?s|px|[cm]?m)\b|%)", GAP, text)


def headline(verdict: str) -> tuple[str, str]:
    """The first sentence of a verdict, and the rest."""
    verdict = tie(verdict)
    end = verdict.find(". ")
    return (verdict, "") if end < 0 else (verdict[: end + 1], verdict[end + 2 :].strip())


def control(result: CompareResult) -> str:
    """What the things at rest say: whether timing alone can explain the difference."""
    if result.stereo is None:
        return ""
    synced, offset = result.stereo.synced, result.stereo.offset
    pair = (synced.static_within_2pct, offset.static_within_2pct)
    if None in pair:
        pair = (synced.static_coverage, offset.static_coverage)
    if pair[0] is None or pair[1] is None:
        return ""
    values = f"({share(pair[0])} and {share(pair[1])})"
    if abs(pair[0] - pair[1]) >= 0.02:
        return (
            f"Things at rest are the control, and here they differ too {values}: not all of the difference "
            "comes from timing."
        )
    moving = (synced.mover_within_2pct, offset.mover_within_2pct)
    if None in moving:
        moving = (synced.mover_coverage, offset.mover_coverage)
    if moving[0] is None or moving[1] is None or moving[0] - moving[1] < CLEAR_SHARE:
        return f"Things at rest are the control: they do as well either way {values}."
    return (
        f"Things at rest are the control: they do as well either way {values}, so the difference on moving "
        "things comes from timing alone."
    )


def synchronization(residual_us: float | None, bound_us: float | None) -> str:
    """How far the pictures are from their instants by the session's own record."""
    parts = []
    if residual_us is not None:
        parts.append(f"every synchronized picture within {microseconds(residual_us)} of its instant")
    if bound_us is not None:
        parts.append(f"the clocks agree to {microseconds(bound_us)} at the very worst")
    return "; ".join(parts) or "not known: the session has no record of its clocks"
