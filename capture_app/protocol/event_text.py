"""Events as lines for people, and as records: at a leader, at a relay, and at a camera's node."""

import re
from collections.abc import Callable
from typing import Any

import msgspec

from capture_app.common.address import Address
from capture_app.common.text import count, duration
from capture_app.protocol.messages import EventValue
from capture_app.protocol.status import BurstStatus
from capture_app.sync.rig import events, status_text
from capture_app.sync.rig.frame_selection import SLEPT
from capture_app.sync.rig.time_client import TimeClientEvent
from capture_app.sync.timekeeping import clock_events
from capture_app.sync.timekeeping.rates import HostOffRate
from capture_app.trust.sealing import DatagramsRefused

_NODE_LINES = {
    "joined": "{2} joined",
    "returned": "{2} is back",
    "lost": "lost {2}: {0.reason}",
    "forgotten": "forgot {2}, which was lost",
    "moved": "{2} is now connected to {1}",
    "refused": "refused {0.name} {0.where}: {0.reason}",
}
_LEADER_LINES = {"refused": "join-refused", "said": "leader-said", "lost": "leader-lost"}
_EVENT_FIELDS: dict[type, tuple[str, tuple[str, ...]]] = {
    events.Joined: ("joined", ("leader",)),
    events.ForeignTrigger: ("foreign-trigger", ("leader", "burst")),
    events.TriggerCancelled: ("burst-cancelled", ("leader", "burst")),
    events.FramesDropped: ("frames-dropped", ("count", "sequence")),
    events.PhaseMoved: ("phase-moved", ("local_ns", "shift_ns")),
    events.AlignmentFailed: ("alignment-failed", ("reason",)),
    clock_events.StepRefused: ("clock-step-refused", ("times",)),
    clock_events.ClockRateUnusual: ("clock-rate-unusual", ("fast_ppm",)),
    clock_events.TimesDoubted: ("times-doubted", ("from_local_ns", "until_local_ns", "error_ns")),
}
"""Each event's name in the log, and the fields that are copied from it."""


RigEvent = events.LeaderEvent | HostOffRate | DatagramsRefused | BurstStatus
"""Events that a leader logs: nodes that come and go, clock problems, damaged seals, and bursts."""


def leader_line(event: RigEvent, title_of: Callable[[str], str] = str) -> tuple[str, bool]:
    """Return a line for people about an event at a leader, and whether it needs attention.

    The line is empty if the event is not worth one. `title_of` returns what people call a node.
    """
    match event:
        case events.NodeChanged(name, change, _, where):
            words = event, where or "this leader", title_of(name)
            return _NODE_LINES[change].format(*words), change in ("lost", "refused")
        case events.TriggerAnswered(name, burst, refusal):
            return f"burst {burst}: without {title_of(name)}: {refusal}" if refusal else "", True
        case HostOffRate():
            return off_rate_line(event, title_of), bool(event.fast_ppm)
        case DatagramsRefused():
            return str(event), True
        case BurstStatus():
            return burst_line(event), event.session is None or event.received != event.expected


def off_rate_line(off: HostOffRate, title_of: Callable[[str], str] = str) -> str:
    """Return a line on a clock at an unusual rate and possible causes, or on its return to the baseline."""
    whose = title_of(off.name) if off.name else "the leader"
    if not off.fast_ppm:
        return f"the clock of {whose} runs at its normal rate again"
    against = "the leader's" if off.ambiguous else "all others"
    return (
        f"the clock of {whose} runs {status_text.fast_or_slow(off.fast_ppm)} against"
        f" {against}: its NTP daemon is slewing it, or it is a virtual machine"
        + (" (or the leader's clock is)" if off.ambiguous else "")
    )


def relay_line(event: TimeClientEvent, parent: Address) -> str:
    """Return a line about a relay's connection to its own leader; empty if there is nothing to log."""
    match event:
        case events.Joined():
            return f"joined {parent}"
        case events.LeaderNotice("lost"):
            return f"lost {parent} ({event.text}): in holdover"
        case events.LeaderNotice("said"):
            return f"{parent} says: {event.text}"
        case events.LeaderNotice():
            return f"{parent} refused this relay: {event.text}"
        case clock_events.ClockSynced():
            return f"ready: clock error at most {duration(event.time_map.hard_bound_ns)}"
    return _clock_line(event)


def burst_line(burst: BurstStatus) -> str:
    """Return a line on a burst's progress."""
    if not burst.burst:
        return burst.message
    text = f"burst {burst.burst}: {burst.received} of {burst.expected} images"
    if burst.done:
        text += f", saved as {burst.session}" if burst.session else ", no session"
    return ("; " if burst.done else ", ").join(filter(None, (text, burst.message)))


def leader_record(event: RigEvent) -> dict[str, object]:
    """Return the fields of an event at a leader, for its line of JSON."""
    match event:
        case events.NodeChanged(name, change, reason, where):
            fields: dict[str, dict[str, object]] = {
                "moved": {"relay": where or None},
                "refused": {"where": where, "reason": reason},
                "lost": {"reason": reason},
            }
            return {"event": f"node-{change}", "name": name, **fields.get(change, {})}
        case events.TriggerAnswered(name, burst, refusal=""):
            return {"event": "burst-accepted", "name": name, "burst": burst}
        case events.TriggerAnswered(name, burst, refusal):
            return {"event": "burst-refused", "name": name, "burst": burst, "reason": refusal}
        case HostOffRate(name, fast_ppm=0.0):
            return {"event": "host-at-rate", "name": name}
    kind = re.sub(r"(?<!^)(?=[A-Z])", "-", type(event).__name__).lower()
    return {"event": kind, **msgspec.to_builtins(event)}


def client_record(event: events.ClientEvent[Any]) -> dict[str, EventValue]:
    """Return an event at a camera's node as a flat JSON object, for its burst's report."""
    match event:
        case events.LeaderNotice(what, text):
            return {"event": _LEADER_LINES[what], "text" if what == "said" else "reason": text}
        case clock_events.ClockSynced(time_map):
            return {
                "event": "clock-synced",
                "offset_ns": time_map.offset_ns,
                "hard_bound_ns": round(time_map.hard_bound_ns),
            }
        case clock_events.ClockChanged(jumped):
            return {"event": "clock-stepped" if jumped else "clock-rate-changed"}
        case clock_events.ClockRateUnusual(None):
            return {"event": "clock-rate-usual"}
        case events.PhaseCorrected(command, before):
            return {
                "event": "phase-corrected",
                "command": type(command).__name__,
                **msgspec.to_builtins(command),
                "phase_error_ns": None if before is None else before.error_ns,
            }
    name, taken = _EVENT_FIELDS.get(type(event), (type(event).__name__, ()))
    return {"event": name} | {field: getattr(event, field) for field in taken}


def client_line(event: events.ClientEvent[Any]) -> str:
    """Return a line for people about an event at a camera's node; empty for none."""
    match event:
        case events.LeaderNotice("said"):
            return f"the leader says: {event.text}"
        case events.LeaderNotice():
            return f"{_LEADER_LINES[event.what]}: {event.text}"
        case events.AlignmentFailed():
            return f"alignment-failed: {event.reason}"
        case events.ForeignTrigger():
            return f"refused a trigger for burst {event.burst}: it is from a leader that is not followed"
    return _clock_line(event)


def why_doubted(event: clock_events.TimesDoubted) -> str:
    """Describe why times of an interval were wrong."""
    if event.from_local_ns == event.until_local_ns:
        return SLEPT
    what = "a clock was changed" if event.jumped else "a clock ran faster or slower"
    return f"{what}, which was noticed only afterwards: these times are known to {duration(event.error_ns)}"


def _clock_line(event: object) -> str:
    """Describe a clock event; empty for events that need no report."""
    match event:
        case clock_events.ClockChanged(jumped=True):
            return "a clock was changed: synchronizing again"
        case clock_events.StepRefused():
            return (
                f"{count(event.times, 'answer')} of the leader contradicted all other answers and did not"
                " count: a device on the network may alter them"
            )
        case clock_events.ClockRateUnusual(fast_ppm) if fast_ppm is not None:
            return status_text.fast_clock(fast_ppm)
        case clock_events.ClockChanged():
            return status_text.RATE_CHANGED
    return ""
