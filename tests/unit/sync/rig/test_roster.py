"""Who is a member of a leader, for how long, and whose frame rate the rig's grid has."""

import random

import pytest
from msgspec import structs

from capture_app.common.camera_facts import PhaseControl
from capture_app.common.node_state import NodeState
from capture_app.sync.rig import roster
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.rig.events import NodeChanged
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.rig.rig_config import RequestedConfig
from capture_app.sync.wire.codec import decode, encode
from capture_app.sync.wire.datagrams import (
    Goodbye,
    Heartbeat,
    HeartbeatAck,
    Hello,
    MemberReports,
    Report,
    UnknownMember,
    Welcome,
)
from tests.facts import make_facts

S = 1_000_000_000
USUAL_NS, LONG_NS = 33_333_333, 20 * S
FULL = 500
"""Clients of a full rig here; the real limit takes seconds to reach."""


def joined(leader: Leader, name: str, now_ns: int, period_ns: int = USUAL_NS) -> int:
    """Let a camera say hello; return its number."""
    hello = Hello(name, len(name), make_facts(period_ns=period_ns))
    leader.receive_datagram(encode(hello), (name, 0), now_ns)
    messages = [decode(data) for data, _ in leader.datagrams_to_send(now_ns)]
    return next(message.client for message in messages if isinstance(message, Welcome))


def beat(leader: Leader, number: int, now_ns: int) -> None:
    heartbeat = Heartbeat(number, Report(state=NodeState.READY))
    leader.receive_datagram(encode(heartbeat), ("cam", 0), now_ns)


def changes(leader: Leader) -> list[str]:
    return [event.change for event in iter(leader.next_event, None) if isinstance(event, NodeChanged)]


def names(leader: Leader, now_ns: int) -> list[str]:
    return [view.name for view in leader.roster.by_name()]


@pytest.fixture
def leader() -> Leader:
    return Leader(LeaderConfig(1, 0), random.Random(2))


def test_the_grid_is_laid_again_when_its_camera_is_lost(leader: Leader) -> None:
    slow = joined(leader, "odd", S, LONG_NS)
    number = joined(leader, "cam", S)
    assert leader.grid is not None
    assert leader.grid.period_ns == LONG_NS
    leader.receive_datagram(encode(Goodbye(slow)), ("odd", 0), 2 * S)
    leader.datagrams_to_send(2 * S)
    leader.handle_timer(2 * S)
    assert leader.grid.period_ns == USUAL_NS
    told = [decode(data) for data, _ in leader.datagrams_to_send(2 * S)]
    acks = [message for message in told if isinstance(message, HeartbeatAck)]
    assert [(ack.client, ack.config.period_ns) for ack in acks] == [(number, USUAL_NS)]


def test_the_grid_stays_while_a_camera_runs_at_its_rate(leader: Leader) -> None:
    first = joined(leader, "cam", S)
    joined(leader, "other", S, USUAL_NS + 5_000)
    before = leader.grid
    leader.receive_datagram(encode(Goodbye(first)), ("cam", 0), 2 * S)
    leader.handle_timer(2 * S)
    joined(leader, "odd", 3 * S, LONG_NS)
    assert leader.grid == before


def test_with_no_camera_left_the_next_one_lays_the_grid(leader: Leader) -> None:
    number = joined(leader, "odd", S, LONG_NS)
    leader.receive_datagram(encode(Goodbye(number)), ("odd", 0), 2 * S)
    leader.handle_timer(2 * S)
    joined(leader, "cam", 3 * S)
    assert leader.grid is not None
    assert leader.grid.period_ns == USUAL_NS


def test_a_requested_rate_is_not_changed() -> None:
    leader = Leader(LeaderConfig(1, 0, RequestedConfig(period_ns=LONG_NS)), random.Random(2))
    number = joined(leader, "cam", S)
    leader.receive_datagram(encode(Goodbye(number)), ("cam", 0), 2 * S)
    leader.handle_timer(2 * S)
    beat(leader, joined(leader, "other", 3 * S), 3 * S)
    beat(leader, (number := joined(leader, "third", 3 * S)), 3 * S)
    leader.receive_datagram(encode(Goodbye(number)), ("third", 0), 4 * S)
    leader.handle_timer(4 * S)
    assert leader.grid is not None
    assert leader.grid.period_ns == LONG_NS


def test_more_hellos_than_clients_keep_nobody_out_and_are_forgotten(
    leader: Leader, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(roster, "MAX_CLIENTS", FULL)
    beat(leader, joined(leader, "cam", S), S)
    for number in range(FULL + 50):
        hello = Hello(f"x{number}", number, make_facts(period_ns=LONG_NS))
        leader.receive_datagram(encode(hello), ("x", number), S + number)
    leader.datagrams_to_send(2 * S)
    number = joined(leader, "late", 2 * S)
    beat(leader, number, 2 * S)
    assert len(leader.roster.by_name()) == FULL
    assert leader.grid is not None
    assert leader.grid.period_ns == USUAL_NS, "who has only said hello does not set the rate"
    for at_s in (3, 4):
        leader.handle_timer(at_s * S)
    assert names(leader, 4 * S) == ["cam", "late"], "of the others nobody has ever been heard"


def test_a_member_that_is_lost_for_the_longest_makes_room_in_a_full_rig(
    leader: Leader, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(roster, "MAX_CLIENTS", FULL)
    for number in range(FULL):
        at_ns = S + number
        beat(leader, joined(leader, f"c{number}", at_ns), at_ns)
    with pytest.raises(StopIteration):
        joined(leader, "late", S + FULL)
    leader.handle_timer(4 * S)
    joined(leader, "late", 5 * S)
    assert "late" in names(leader, 5 * S)
    assert "c0" not in names(leader, 5 * S)
    assert "c1" in names(leader, 5 * S)


def test_a_camera_that_its_relay_never_reports_is_removed(leader: Leader) -> None:
    """The answer to its hello was lost on the way to the relay, and then it was switched off."""
    relay = joined(leader, "relay", S)
    leader.receive_datagram(encode(Hello("cam", 7, make_facts(), "relay")), ("relay", 0), S)
    cam = leader.roster.members["cam"].number
    report = MemberReports(((cam, Report(state=NodeState.READY)),))
    for at_s in range(2, 20):
        beat(leader, relay, at_s * S)
        if at_s < 10:
            leader.receive_datagram(encode(report), ("relay", 0), at_s * S)
        leader.handle_timer(at_s * S)
        assert leader.roster.members["cam"].lost == ("" if at_s < 16 else "silent for 6 s"), at_s
    assert not leader.roster.members["relay"].lost


@pytest.mark.parametrize(
    ("first_ns", "others", "expected_ns"),
    [
        (2 * USUAL_NS, (USUAL_NS, USUAL_NS), USUAL_NS),
        (2 * USUAL_NS, (USUAL_NS,), 2 * USUAL_NS),
        (LONG_NS, (USUAL_NS,), USUAL_NS),
        (USUAL_NS, (LONG_NS, LONG_NS, LONG_NS), USUAL_NS),
        (LONG_NS, (LONG_NS, 3 * LONG_NS), LONG_NS),
        (USUAL_NS, (USUAL_NS + 5_000, 2 * USUAL_NS, 2 * USUAL_NS), USUAL_NS),
    ],
)
def test_the_majority_of_the_cameras_sets_the_grid(
    leader: Leader, first_ns: int, others: tuple[int, ...], expected_ns: int
) -> None:
    """A webcam that comes up in the dark first, at half its rate; a stranger that claims a frame a minute."""
    numbers = [joined(leader, "odd", S, first_ns)]
    numbers += [joined(leader, f"cam{number}", S, of) for number, of in enumerate(others)]
    for number in numbers:
        beat(leader, number, 2 * S)
        leader.handle_timer(2 * S)
    assert leader.grid is not None
    assert leader.grid.period_ns == expected_ns
    told = [decode(data) for data, _ in leader.datagrams_to_send(2 * S)]
    newest = {message.client: message.config for message in told if isinstance(message, HeartbeatAck)}
    assert {config.period_ns for config in newest.values()} == {expected_ns}
    assert newest.keys() == {*numbers}


def test_a_camera_that_moves_to_another_relay_takes_part_without_a_pause(leader: Leader) -> None:
    beat(leader, joined(leader, "cam", S), S)
    for via in ("gate", "tower"):
        moved = Hello("cam", len("cam"), make_facts(period_ns=USUAL_NS), via)
        leader.receive_datagram(encode(moved), (via, 0), S)
        assert leader.trigger(S, BurstOrder(frames=1)).clients == ("cam",)
    leader.receive_datagram(encode(Hello("other", 9, make_facts())), ("other", 0), S)
    assert leader.trigger(S, BurstOrder(frames=1)).clients == ("cam",), (
        "of the other nothing but a hello was heard"
    )


def test_a_member_that_is_dropped_is_told(leader: Leader) -> None:
    number = joined(leader, "cam", S)
    leader.drop_member(leader.roster.members["cam"], "its name is another machine's")
    assert [decode(data) for data, _ in leader.datagrams_to_send(S)] == [UnknownMember(number)]


def test_cameras_of_one_machine_alone_align_nothing() -> None:
    members = roster.Roster(random.Random(2), {})
    for number, (pin, is_ready) in enumerate([("this", None), ("this", None), ("that", True)]):
        hello = Hello(f"cam{number}", number, make_facts(phase_control=PhaseControl.RESET), pin=pin)
        member, _ = members.admit(hello, ("cam", number), 0)
        member.report = Report(state=NodeState.READY)
        assert members.is_ready() is is_ready


def test_a_refusal_names_cameras_as_their_owners(leader: Leader) -> None:
    first = Hello("Bohm", 1, make_facts(period_ns=USUAL_NS, label="Böhm"))
    leader.receive_datagram(encode(first), ("a", 0), S)
    assert leader.roster.title("Bohm") == "Böhm"
    assert leader.roster.title("other") == "other"
    same = structs.replace(first, instance=2)
    assert "another camera named Böhm is here" in leader.roster.refusal(same)
    plain = structs.replace(same, camera=make_facts(period_ns=USUAL_NS))
    assert leader.roster.refusal(plain).startswith("Böhm is here, and Bohm would be the same folder")
    other_case = structs.replace(plain, name="BOHM")
    assert leader.roster.refusal(other_case).startswith("Böhm is here, and BOHM would be the same folder")


def test_a_label_is_printable_as_a_message_brings_it() -> None:
    hello = decode(encode(Hello("a", 1, make_facts(label="カメラ\x1b[2J"))))
    assert isinstance(hello, Hello)
    assert hello.camera.label == "カメラ\ufffd[2J"
