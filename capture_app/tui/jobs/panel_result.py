"""What `capture-app panel read` found, in words and as tables."""

from collections.abc import Mapping
from typing import Any

from capture_app.text import NO_VALUE, count, duration

_KINDS = ("total", "phase", "clock")
Words = tuple[str, ...]


def panel_verdict(found: Mapping[str, Any]) -> str:
    """How far apart the cameras were, in a sentence."""
    errors = found["errors"]
    every = errors["all"]
    if every is None:
        return "no instant has two pictures that tell the time"
    total = every["total"]
    largest = "" if every["count"] == 1 else f" on average, {duration(total['max_ns'])} at most"
    told = f"{duration(total['mean_abs_ns'])} apart{largest}"
    held = errors["within_uncertainty"]
    bars = "" if held is None else f"; clocks inside their error bars: {held['held']} of {held['count']}"
    return f"{told}; the panel tells ±{duration(every['reading_uncertainty_ns'])}{bars}"


def panel_tables(found: Mapping[str, Any]) -> tuple[tuple[str, Words, Words, tuple[Words, ...]], ...]:
    """Tables as (caption, groups, columns, rows): the paper's for each pair, and what each camera told."""
    errors = found["errors"]
    pairs = errors["pairs"]
    if len(pairs) > 1:
        pairs = [*pairs, {**errors["all"], "cameras": ["all pairs"]}]
    apart = tuple(
        (
            " – ".join(pair["cameras"]),
            *(duration(pair[kind][what]) for kind in _KINDS for what in ("mean_abs_ns", "max_ns")),
        )
        for pair in pairs
    )
    groups = tuple(kind for kind in _KINDS for _ in range(2))
    cameras = sorted({one["camera"] for one in (*found["pictures"], *found["refusals"])})
    seen = tuple(_camera(found, name) for name in cameras)
    what = "How far apart (phase: by the stamps; clock: the rest)"
    tables: tuple[tuple[str, Words, Words, tuple[Words, ...]], ...] = (
        (what, groups, ("mean", "largest") * len(_KINDS), apart),
        (f"The panel {found['panel']} in the pictures", ("",) * 3, ("read", "refused", "± (95 %)"), seen),
    )
    return tables if apart else tables[1:]


def panel_remarks(found: Mapping[str, Any]) -> tuple[str, ...]:
    """What limits it, and which pictures were refused."""
    tick, cycle = duration(found["tick_ns"]), duration(found["cycle_ns"])
    remarks = [f"the panel changes every {tick} and shows the same again after {cycle}"]
    if not found["exposures_known"]:
        remarks.append("exposures and row times are not all known: part of the clock's error may be theirs")
    refused = found["refusals"]
    reasons = dict.fromkeys(refusal["reason"] for refusal in refused)
    remarks += [
        f"{count(sum(refusal['reason'] == reason for refusal in refused), 'picture')} refused: {reason}"
        for reason in reasons
    ]
    return tuple(remarks)


def _camera(found: Mapping[str, Any], name: str) -> tuple[str, ...]:
    bars = sorted(one["uncertainty_ns"] for one in found["pictures"] if one["camera"] == name)
    refused = sum(one["camera"] == name for one in found["refusals"])
    return name, str(len(bars)), str(refused), duration(bars[len(bars) // 2]) if bars else NO_VALUE
