"""A node's clock, phase and events as the manifest, the report and the event log record them."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import msgspec

from capture_app.camera_facts import SIMULATED, CameraFacts, Control
from capture_app.cameras.base import CapturedFrame, DeviceClock
from capture_app.clock import NodeClock, SimulatedClock
from capture_app.node.wire.messages import CameraReport, JsonValue
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.manifest import CameraRecord, ClockRecord, MissingImage, PhaseRecord
from capture_app.sync.rig import events, node_message
from capture_app.sync.rig.frame_selection import DROPPED, Gap
from capture_app.sync.timekeeping import clock_events


def camera_record(
    name: str,
    facts: CameraFacts,
    ready: events.FramesSelected[Any],
    corrections: int,
    tolerance_ns: int,
    device: DeviceClock | None = None,
    held: Mapping[Control, float] | None = None,
) -> CameraRecord:
    """The manifest's record of a camera at a burst; `corrections` counts those of the phase until then.

    `tolerance_ns` is how near to the rig's grid the phase was to be held; `device` is the camera's own clock,
    where it stamps by one; `held` are the controls that somebody set.
    """
    time_map, phase = ready.time_map, ready.phase
    relative_ns = time_map.relative_uncertainty_ns
    return CameraRecord(
        name=name,
        facts=facts,
        held=dict(held) if held else msgspec.UNSET,
        clock=ClockRecord(
            epoch_local_ns=time_map.epoch_local_ns,
            offset_ns=time_map.offset_ns,
            skew_ppm=time_map.skew * 1e6,
            uncertainty_ns=round(time_map.uncertainty_ns),
            hard_bound_ns=round(time_map.hard_bound_ns),
            round_trip_ns=time_map.round_trip_ns,
            samples=time_map.samples,
            reference_correction_ns=time_map.reference_correction_ns,
            relative_uncertainty_ns=None if relative_ns is None else round(relative_ns),
            device_uncertainty_ns=None if device is None else device.uncertainty_ns,
            device_hard_bound_ns=None if device is None else device.hard_bound_ns,
        ),
        phase=None
        if phase is None
        else PhaseRecord(
            residual_ns=phase.error_ns,
            period_ns=round(phase.period_ns),
            drift_ppm=phase.drift_ppm,
            corrections=corrections,
            uncertainty_ns=round(1.96 * phase.sigma_ns),
            tolerance_ns=tolerance_ns,
        ),
    )


def with_device_clock(picked: events.FramesSelected[CapturedFrame]) -> events.FramesSelected[CapturedFrame]:
    """Add to the error of each pick that of the clock which its device stamps by."""
    picks = tuple(
        replace(pick, uncertainty_ns=pick.uncertainty_ns + pick.frame.clock_uncertainty_ns)
        for pick in picked.frames
    )
    return replace(picked, frames=picks)


def camera_report(
    camera: CameraRecord,
    ready: events.FramesSelected[Any],
    calibration: CameraCalibration | None,
    true_clock: SimulatedClock | None,
    events: tuple[dict[str, JsonValue], ...],
) -> CameraReport:
    """What a node tells the root of its part of a burst."""
    plan = CameraPlan(
        camera=camera,
        reported=True,
        instants=tuple(pick.instant for pick in ready.frames),
        missing=missing_images(camera.name, ready.gaps),
        calibration=calibration,
        true_clock=true_clock,
    )
    return CameraReport(leader=ready.leader, burst=ready.burst, plan=plan, events=events)


def missing_images(camera: str, gaps: Iterable[Gap]) -> tuple[MissingImage, ...]:
    """What a camera tells of instants that it has no frame of."""
    return tuple(
        MissingImage(camera=camera, instant=gap.instant, reason=gap.reason, dropped=gap.reason == DROPPED)
        for gap in gaps
    )


def true_clock(clock: NodeClock, facts: CameraFacts) -> SimulatedClock | None:
    """The truth about a node's clock, where the simulator knows it."""
    if isinstance(clock, SimulatedClock):
        return clock
    return SimulatedClock(0) if facts.kind == SIMULATED else None


_LEADER_LINES = {"refused": "join-refused", "said": "leader-said", "lost": "leader-lost"}
_EVENT_FIELDS: dict[type, tuple[str, tuple[str, ...]]] = {
    events.Joined: ("joined", ("leader",)),
    events.StrangeTrigger: ("strange-trigger", ("leader", "burst")),
    events.FramesDropped: ("frames-dropped", ("count", "sequence")),
    events.AlignmentFailed: ("alignment-failed", ("reason",)),
    clock_events.StepRefused: ("clock-step-refused", ("times",)),
    clock_events.WayLonger: ("way-longer", ("longer_ns",)),
    clock_events.ClockRateUnusual: ("clock-rate-unusual", ("fast_ppm",)),
}
"""What a line calls an event, and the fields that it takes over from it."""


def event_line(event: events.ClientEvent[Any]) -> dict[str, JsonValue]:
    """An event as a flat line of JSON."""
    match event:
        case events.LeaderNews(what, text):
            return {"event": _LEADER_LINES[what], "text" if what == "said" else "reason": text}
        case clock_events.ClockSynced(time_map):
            bound_ns = round(time_map.hard_bound_ns)
            return {"event": "clock-synced", "offset_ns": time_map.offset_ns, "hard_bound_ns": bound_ns}
        case clock_events.ClockChanged(jumped):
            return {"event": "clock-stepped" if jumped else "clock-rate-changed"}
        case clock_events.ClockRateUnusual(None):
            return {"event": "clock-rate-usual"}
        case clock_events.ReferenceCorrected(None):
            return {"event": "reference-correction-ended"}
        case clock_events.ReferenceCorrected(uncertainty_ns):
            return {"event": "reference-correction-started", "relative_uncertainty_ns": uncertainty_ns}
        case events.PhaseCorrected(command, before):
            error_ns = None if before is None else before.error_ns
            fields = msgspec.to_builtins(command) | {"phase_error_ns": error_ns}
            return {"event": "phase-corrected", "command": type(command).__name__, **fields}
    name, taken = _EVENT_FIELDS.get(type(event), (type(event).__name__, ()))
    return {"event": name} | {field: getattr(event, field) for field in taken}


def event_words(event: events.ClientEvent[Any]) -> str:
    """Return what a user should hear of an event; empty where nothing."""
    match event:
        case events.LeaderNews("said"):
            return f"the leader says: {event.text}"
        case events.LeaderNews():
            return f"{_LEADER_LINES[event.what]}: {event.text}"
        case events.AlignmentFailed():
            return f"alignment-failed: {event.reason}"
        case events.StrangeTrigger():
            return f"refused a trigger for burst {event.burst}: it is not of the leader that is followed"
    return node_message.of_event(event)
