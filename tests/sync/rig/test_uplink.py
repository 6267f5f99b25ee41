"""What a relay says for its members, message by message."""

import random

import pytest
from msgspec import structs

from capture_app.common.node_state import CLOCK_ONLY, NodeState
from capture_app.sync.rig.relay_summary import ACKS_WAIT_NS, SUM_EVERY_NS, TOO_LONG, Uplink
from capture_app.sync.rig.roster import Member, Roster
from capture_app.sync.wire.codec import MAX_DATAGRAM, decode, encode
from capture_app.sync.wire.messages import (
    MAX_TEXT,
    Goodbye,
    Heartbeat,
    Hello,
    MemberReports,
    Report,
    TriggerAck,
)
from tests.facts import make_facts

CAMERA = make_facts()
REPORT = Report(state=NodeState.READY)
S = 1_000_000_000
LONGEST = structs.replace(
    Report(state=NodeState.READY, message="\U0001f4f7" * MAX_TEXT),
    **dict.fromkeys(Report.__struct_fields__[2:], 2**63 - 1),
)
"""Takes the most bytes."""


@pytest.fixture
def roster() -> Roster:
    return Roster(random.Random(1))


@pytest.fixture
def uplink() -> Uplink:
    uplink = Uplink("hall")
    uplink.restart(has_parent=True)
    return uplink


def admitted(roster: Roster, name: str, instance: int, kind: str = "sim", via: str | None = None) -> Member:
    hello = Hello(name, instance, structs.replace(CAMERA, kind=kind), via)
    return roster.admit(hello, ("10.0.0.2", 5), 0)[0]


def said(uplink: Uplink) -> list[object]:
    return [decode(data) for data in uplink.datagrams_to_send()]


def known(uplink: Uplink, roster: Roster, count: int, first: int = 1) -> list[Member]:
    """Members that the parent knows by 100 more than their runs."""
    members = [admitted(roster, f"cam{i}", i) for i in range(first, first + count)]
    for member in members:
        uplink.pass_up(member, Heartbeat(member.number, REPORT), 0)
        uplink.note_welcome(member.instance, 100 + member.instance, roster.members)
    said(uplink)
    return members


def summed(uplink: Uplink, now_ns: int) -> list[int]:
    """What goes up when sums are due: the numbers of those whose reports it has."""
    uplink.handle_timer(now_ns)
    sums = said(uplink)
    assert all(isinstance(one, MemberReports) for one in sums)
    return [number for one in sums if isinstance(one, MemberReports) for number, _ in one.reports]


def test_a_member_is_introduced_first_and_then_speaks_under_the_parents_number(
    uplink: Uplink, roster: Roster
) -> None:
    member = admitted(roster, "cam", 7)
    beat = Heartbeat(member.number, REPORT)
    assert not uplink.pass_up(member, beat, 0)
    assert said(uplink) == [Hello("cam", 7, CAMERA, "hall")]
    uplink.note_welcome(7, 99, roster.members)
    assert uplink.member(99) is member
    assert uplink.pass_up(member, beat, 0), "the root is to know before it is answered"
    uplink.handle_timer(0)
    assert said(uplink) == [MemberReports(((99, REPORT),))]
    assert not uplink.pass_up(member, beat, 1), "and knows from then on"
    assert not uplink.pass_up(member, Goodbye(member.number), 1)
    assert said(uplink) == [Goodbye(99)]


def test_many_members_take_no_more_messages_than_few(uplink: Uplink, roster: Roster) -> None:
    members = known(uplink, roster, 100)
    for member in members:
        uplink.pass_up(member, Heartbeat(member.number, REPORT), 0)
    assert len(summed(uplink, 0)) == 100, "at first all of them are news"
    told: list[int] = []
    for turn in range(1, 21):
        for member in members:
            uplink.pass_up(member, Heartbeat(member.number, REPORT), turn * SUM_EVERY_NS)
        uplink.handle_timer(turn * SUM_EVERY_NS)
        (one,) = said(uplink)
        assert isinstance(one, MemberReports)
        told += [number for number, _ in one.reports]
    assert sorted(told) == sorted(2 * [100 + member.instance for member in members]), "each in turn"
    failed = Heartbeat(members[50].number, Report(state=NodeState.FAILED))
    assert uplink.pass_up(members[50], failed, 0)
    assert summed(uplink, 30 * SUM_EVERY_NS)[0] == 100 + members[50].instance, "what is new goes first"


def test_reports_of_the_longest_texts_go_up_too(uplink: Uplink, roster: Roster) -> None:
    for member in known(uplink, roster, 12):
        uplink.pass_up(member, Heartbeat(member.number, LONGEST), 0)
    assert len(summed(uplink, 0)) == 12


def test_one_that_is_lost_is_told_of_until_the_parent_knows_it_no_more(
    uplink: Uplink, roster: Roster
) -> None:
    (member,) = known(uplink, roster, 1)
    roster.mark_lost(member, "silent for 2 s")
    for turn in range(3):
        uplink.handle_timer(turn * SUM_EVERY_NS)
        assert said(uplink) == [MemberReports(((101, member.report),))]
    uplink.note_unknown(101)
    assert summed(uplink, 4 * SUM_EVERY_NS) == []


def test_of_a_member_that_is_another_run_now_the_one_before_is_told_as_lost(
    uplink: Uplink, roster: Roster
) -> None:
    (member,) = known(uplink, roster, 1)
    roster.mark_lost(member, "silent for 2 s")
    again = admitted(roster, "cam1", 77)
    uplink.pass_up(again, Hello("cam1", 77, CAMERA), 0)
    assert said(uplink) == [Hello("cam1", 77, CAMERA, "hall")]
    # Else the parent, which hears the relay, would keep the name for it.
    for turn in range(2):
        assert summed(uplink, turn * SUM_EVERY_NS) == [101]
    uplink.note_unknown(101)
    assert summed(uplink, 3 * SUM_EVERY_NS) == []


def test_answers_to_a_trigger_go_up_together_but_for_those_that_refuse(
    uplink: Uplink, roster: Roster
) -> None:
    members = known(uplink, roster, 300)
    for member in members:
        refusal = "no room" if member.instance % 100 == 0 else ""
        uplink.pass_up(member, TriggerAck(member.number, 1, 2, refusal), S)
    assert uplink.next_timer() <= S + ACKS_WAIT_NS
    uplink.handle_timer(S + ACKS_WAIT_NS)
    acks = [one for one in said(uplink) if isinstance(one, TriggerAck)]
    numbers: dict[str, list[int]] = {refusal: [] for refusal in ("", "no room")}
    for ack in acks:
        numbers[ack.refusal] += [ack.client, *ack.others]
    assert len(acks) == 3
    assert [len(found) for found in numbers.values()] == [297, 3]
    assert sorted(numbers[""] + numbers["no room"]) == [100 + member.instance for member in members]


def test_whoever_is_below_a_further_relay_keeps_that_relay_as_its_place(
    uplink: Uplink, roster: Roster
) -> None:
    member = admitted(roster, "cam", 7, via="attic")
    uplink.pass_up(member, Heartbeat(member.number, REPORT), 0)
    assert said(uplink) == [Hello("cam", 7, CAMERA, "attic")]


def test_nodes_that_only_keep_the_time_are_nobodys_business_above(uplink: Uplink, roster: Roster) -> None:
    member = admitted(roster, "clock", 7, kind=CLOCK_ONLY)
    assert not uplink.pass_up(member, Heartbeat(member.number, REPORT), 0)
    assert said(uplink) == []


def test_without_a_parent_nothing_goes_up_and_after_one_everybody_is_introduced_anew(
    uplink: Uplink, roster: Roster
) -> None:
    member = admitted(roster, "cam", 7)
    uplink.pass_up(member, Heartbeat(member.number, REPORT), 0)
    uplink.note_welcome(7, 99, roster.members)
    uplink.restart(has_parent=False)
    assert not uplink.pass_up(member, Heartbeat(member.number, REPORT), 0)
    uplink.restart(has_parent=True)
    assert uplink.member(99) is None
    uplink.pass_up(member, Heartbeat(member.number, REPORT), 0)
    assert said(uplink) == [Hello("cam", 7, CAMERA, "hall")]


def test_a_client_that_the_parent_refused_is_given_up_until_it_is_welcome(
    uplink: Uplink, roster: Roster
) -> None:
    member = admitted(roster, "cam", 7)
    hello = Hello("cam", 7, CAMERA)
    uplink.pass_up(member, hello, 0)
    assert uplink.note_refusal(7, "another camera named cam is here", roster.members) is member
    roster.mark_lost(member, "refused")
    assert uplink.refusal(hello) == "another camera named cam is here"
    assert said(uplink) == [Hello("cam", 7, CAMERA, "hall")] * 2, "the parent is asked again"
    uplink.note_welcome(7, 99, roster.members)
    assert uplink.refusal(hello) == ""
    assert uplink.member(99) is None, "it is not here yet"


def test_what_another_machine_is_refused_drops_nobody(uplink: Uplink, roster: Roster) -> None:
    roster.admit(Hello("cam", 7, CAMERA, pin="own"), ("10.0.0.2", 5), 0)
    uplink.ask(Hello("cam", 7, CAMERA, pin="thief"))
    assert uplink.note_refusal(7, "two machines are called cam", roster.members) is None


def test_a_description_that_would_not_fit_with_the_relays_name_is_refused() -> None:
    uplink = Uplink("r" * 64)
    camera = structs.replace(CAMERA, model="ü" * 200, kind="ü" * 200, pixel_format="p" * 100)
    size = len(encode(Hello("cam", 7, camera)))
    camera = structs.replace(camera, pixel_format="p" * (100 + MAX_DATAGRAM - size))
    hello = Hello("cam", 7, camera)
    assert len(encode(hello)) <= MAX_DATAGRAM
    assert uplink.refusal(hello) == TOO_LONG
    assert uplink.refusal(Hello("cam", 7, CAMERA)) == ""


def test_names_that_are_made_up_fill_no_memory(roster: Roster) -> None:
    uplink = Uplink("hall", max_members=3)
    uplink.restart(has_parent=True)
    for instance in range(20):
        uplink.pass_up(
            admitted(roster, f"cam{instance}", instance), Hello(f"cam{instance}", instance, CAMERA), 0
        )
        uplink.note_refusal(instance, "no", roster.members)
        uplink.pass_up(admitted(roster, f"more{instance}", 100 + instance), Hello("x", 1, CAMERA), 0)
    assert uplink.remembered <= 6
