"""Each event is a line for people, and a record for programs: at a leader, a relay and a camera's node."""

from types import SimpleNamespace
from typing import Any

import pytest

from capture_app.common.address import Address
from capture_app.protocol import event_text as text
from capture_app.protocol.status import BurstStatus
from capture_app.sync.rig import events, status_text
from capture_app.sync.rig.frame_selection import SLEPT
from capture_app.sync.timekeeping import clock_events as clocks
from capture_app.sync.timekeeping.rates import HostOffRate
from capture_app.sync.wire.camera_commands import InjectFrame
from capture_app.trust.sealing import DatagramsRefused, Refused

PARENT = Address("10.0.0.1", 47010)
SYNCED: Any = clocks.ClockSynced(SimpleNamespace(offset_ns=7, hard_bound_ns=1_500_000.4))  # type: ignore[arg-type]
MS = 1_000_000


def burst(number: int = 3, **changes: Any) -> BurstStatus:
    status: dict[str, Any] = {
        "burst": number,
        "name": "walk",
        "cameras": 2,
        "instants": 5,
        "received": 4,
        "expected": 10,
    }
    return BurstStatus(**(status | changes))


def called(name: str) -> str:
    return f"Böhm's {name}"


@pytest.mark.parametrize(
    ("event", "line", "is_warning"),
    [
        (events.NodeChanged("a", "joined"), "Böhm's a joined", False),
        (events.NodeChanged("a", "returned"), "Böhm's a is back", False),
        (events.NodeChanged("a", "lost", "it left"), "lost Böhm's a: it left", True),
        (events.NodeChanged("a", "forgotten"), "forgot Böhm's a, which was lost", False),
        (events.NodeChanged("a", "moved", where="hall"), "Böhm's a is now connected to hall", False),
        (events.NodeChanged("a", "moved"), "Böhm's a is now connected to this leader", False),
        (events.NodeChanged("a", "refused", "full", "at x"), "refused a at x: full", True),
        (events.TriggerAnswered("a", 3), "", True),
        (events.TriggerAnswered("a", 3, "no clock"), "burst 3: without Böhm's a: no clock", True),
        (
            HostOffRate("a", -210.0),
            "the clock of Böhm's a runs 210 ppm slow against all others: its NTP daemon is slewing it, or it"
            " is a virtual machine",
            True,
        ),
        (
            HostOffRate(None, 210.0, ambiguous=True),
            "the clock of the leader runs 210 ppm fast against the leader's: its NTP daemon is slewing it, or"
            " it is a virtual machine (or the leader's clock is)",
            True,
        ),
        (HostOffRate("a", 0.0), "the clock of Böhm's a runs at its normal rate again", False),
        (DatagramsRefused("x", Refused.FORGED, 1), "refused a datagram from x: forged or altered", True),
        (DatagramsRefused("x", Refused.FORGED, 2), "refused 2 datagrams from x: forged or altered", True),
        (burst(), "burst 3: 4 of 10 images", True),
        (burst(message="waiting"), "burst 3: 4 of 10 images, waiting", True),
        (burst(done=True), "burst 3: 4 of 10 images, no session", True),
        (burst(done=True, session="s"), "burst 3: 4 of 10 images, saved as s", True),
        (burst(done=True, session="s", received=10), "burst 3: 10 of 10 images, saved as s", False),
        (burst(done=True, session="s", message="so"), "burst 3: 4 of 10 images, saved as s; so", True),
        (burst(done=True, received=10), "burst 3: 10 of 10 images, no session", True),
        (burst(0, message="the rig is full"), "the rig is full", True),
    ],
)
def test_a_leader_says_what_happened_and_whether_it_needs_attention(
    event: text.RigEvent, line: str, is_warning: bool
) -> None:
    assert text.leader_line(event, called) == (line, is_warning)


@pytest.mark.parametrize(
    ("event", "line"),
    [
        (events.Joined(1, 2), "joined 10.0.0.1:47010"),
        (events.LeaderNotice("lost", "silent"), "lost 10.0.0.1:47010 (silent): in holdover"),
        (events.LeaderNotice("said", "go"), "10.0.0.1:47010 says: go"),
        (events.LeaderNotice("refused", "full"), "10.0.0.1:47010 refused this relay: full"),
        (SYNCED, "ready: clock error at most 1.5 ms"),
        (clocks.ClockChanged(True), "a clock was changed: synchronizing again"),
    ],
)
def test_a_relay_says_what_becomes_of_its_parent(event: Any, line: str) -> None:
    assert text.relay_line(event, PARENT) == line


@pytest.mark.parametrize(
    ("event", "line"),
    [
        (events.LeaderNotice("said", "go"), "the leader says: go"),
        (events.LeaderNotice("refused", "full"), "join-refused: full"),
        (events.LeaderNotice("lost", "silent"), "leader-lost: silent"),
        (events.AlignmentFailed("too fast"), "alignment-failed: too fast"),
        (
            events.ForeignTrigger(6, 2),
            "refused a trigger for burst 2: it is from a leader that is not followed",
        ),
        (clocks.ClockChanged(True), "a clock was changed: synchronizing again"),
        (clocks.ClockChanged(False), status_text.RATE_CHANGED),
        (
            clocks.StepRefused(2),
            "2 answers of the leader contradicted all other answers and did not count: a device on the"
            " network may alter them",
        ),
        (clocks.ClockRateUnusual(210.0), status_text.fast_clock(210.0)),
        (clocks.ClockRateUnusual(None), ""),
        (events.FramesDropped(1, 2), ""),
    ],
)
def test_a_cameras_node_says_what_its_operator_should_know(event: Any, line: str) -> None:
    assert text.client_line(event) == line


@pytest.mark.parametrize(
    ("event", "record"),
    [
        (events.LeaderNotice("said", "go"), {"event": "leader-said", "text": "go"}),
        (events.LeaderNotice("lost", "silent"), {"event": "leader-lost", "reason": "silent"}),
        (SYNCED, {"event": "clock-synced", "offset_ns": 7, "hard_bound_ns": 1_500_000}),
        (clocks.ClockChanged(True), {"event": "clock-stepped"}),
        (clocks.ClockChanged(False), {"event": "clock-rate-changed"}),
        (clocks.ClockRateUnusual(None), {"event": "clock-rate-usual"}),
        (clocks.ClockRateUnusual(2.5), {"event": "clock-rate-unusual", "fast_ppm": 2.5}),
        (clocks.StepRefused(2), {"event": "clock-step-refused", "times": 2}),
        (events.FramesDropped(1, 2), {"event": "frames-dropped", "count": 1, "sequence": 2}),
        (events.ForeignTrigger(6, 2), {"event": "foreign-trigger", "leader": 6, "burst": 2}),
        (events.TriggerCancelled(6, 2), {"event": "burst-cancelled", "leader": 6, "burst": 2}),
        (events.Joined(1, 2), {"event": "joined", "leader": 2}),
        (events.PhaseMoved(5, -3), {"event": "phase-moved", "local_ns": 5, "shift_ns": -3}),
        (events.AlignmentFailed("fast"), {"event": "alignment-failed", "reason": "fast"}),
        (
            events.PhaseCorrected(InjectFrame(9), None),
            {"event": "phase-corrected", "command": "InjectFrame", "exposure_ns": 9, "phase_error_ns": None},
        ),
        (
            events.PhaseCorrected(InjectFrame(9), SimpleNamespace(error_ns=4)),  # type: ignore[arg-type]
            {"event": "phase-corrected", "command": "InjectFrame", "exposure_ns": 9, "phase_error_ns": 4},
        ),
    ],
)
def test_a_cameras_node_records_its_events_for_its_bursts(event: Any, record: dict[str, object]) -> None:
    assert text.client_record(event) == record


def test_why_times_of_a_take_are_doubted_is_said() -> None:
    def why(until_ns: int, jumped: bool) -> str:
        return text.why_doubted(clocks.TimesDoubted(5, until_ns, 2 * MS, 3 * MS, jumped))

    assert why(5, True) == why(5, False) == SLEPT
    assert why(9, True) == (
        "a clock was changed, which was noticed only afterwards: these times are known to 2.0 ms"
    )
    assert why(9, False).startswith("a clock ran faster or slower, which")
