"""What a relay says for its members, message by message."""

import random

import pytest
from msgspec import structs

from capture_app.common.bounds import MAX_TEXT
from capture_app.common.node_state import CLOCK_ONLY, NodeState
from capture_app.sync.rig.relay_summary import (
    ACK_BATCH_NS,
    DESCRIPTION_TOO_LONG,
    REPORT_INTERVAL_NS,
    RelaySummary,
)
from capture_app.sync.rig.roster import LEFT, Member, Roster
from capture_app.sync.wire.codec import MAX_DATAGRAM, decode, encode
from capture_app.sync.wire.datagrams import (
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
RATE = -999_999.9
LONGEST = structs.replace(
    Report(state=NodeState.READY, message="\U0001f4f7" * MAX_TEXT, uploads_wait=True),
    **{field: RATE if field.endswith("ppm") else 10**18 for field in Report.__struct_fields__[2:-1]},
)
"""Takes the most bytes."""


@pytest.fixture
def roster() -> Roster:
    return Roster(random.Random(1))


@pytest.fixture
def summary() -> RelaySummary:
    summary = RelaySummary("hall")
    summary.restart(has_parent=True)
    return summary


def admitted(roster: Roster, name: str, instance: int, kind: str = "sim", via: str | None = None) -> Member:
    hello = Hello(name, instance, structs.replace(CAMERA, kind=kind), via)
    return roster.admit(hello, ("10.0.0.2", 5), 0)[0]


def said(summary: RelaySummary) -> list[object]:
    return [decode(data) for data in summary.datagrams_to_send()]


def known(summary: RelaySummary, roster: Roster, count: int, first: int = 1) -> list[Member]:
    """Members that the parent knows by 100 more than their runs."""
    members = [admitted(roster, f"cam{i}", i) for i in range(first, first + count)]
    for member in members:
        summary.pass_up(member, Heartbeat(member.number, REPORT), 0)
        summary.note_welcome(member.instance, 100 + member.instance, roster.members)
    said(summary)
    return members


def summed(summary: RelaySummary, now_ns: int) -> list[int]:
    """What goes up when sums are due: the numbers of those whose reports it has."""
    summary.handle_timer(now_ns)
    sums = said(summary)
    assert all(isinstance(one, MemberReports) for one in sums)
    return [number for one in sums if isinstance(one, MemberReports) for number, _ in one.reports]


def test_a_member_is_introduced_first_and_then_speaks_under_the_parents_number(
    summary: RelaySummary, roster: Roster
) -> None:
    member = admitted(roster, "cam", 7)
    beat = Heartbeat(member.number, REPORT)
    assert not summary.pass_up(member, beat, 0)
    assert said(summary) == [Hello("cam", 7, CAMERA, "hall")]
    summary.note_welcome(7, 99, roster.members)
    assert summary.member(99) is member
    assert summary.pass_up(member, beat, 0), "the root is to know before it is answered"
    summary.handle_timer(0)
    assert said(summary) == [MemberReports(((99, REPORT),))]
    assert not summary.pass_up(member, beat, 1), "and knows from then on"
    roster.mark_lost(member, LEFT)
    summary.handle_timer(summary.next_timer())
    assert said(summary) == [MemberReports(((99, member.report),))], "also that it has signed off"


def test_many_members_take_no_more_messages_than_few(summary: RelaySummary, roster: Roster) -> None:
    members = known(summary, roster, 100)
    for member in members:
        summary.pass_up(member, Heartbeat(member.number, REPORT), 0)
    assert len(summed(summary, 0)) == 100, "at first all of them are news"
    told: list[int] = []
    for turn in range(1, 21):
        for member in members:
            summary.pass_up(member, Heartbeat(member.number, REPORT), turn * REPORT_INTERVAL_NS)
        summary.handle_timer(turn * REPORT_INTERVAL_NS)
        (one,) = said(summary)
        assert isinstance(one, MemberReports)
        told += [number for number, _ in one.reports]
    assert sorted(told) == sorted(2 * [100 + member.instance for member in members]), "each in turn"
    failed = Heartbeat(members[50].number, Report(state=NodeState.FAILED))
    assert summary.pass_up(members[50], failed, 0)
    assert summed(summary, 30 * REPORT_INTERVAL_NS)[0] == 100 + members[50].instance, "what is new goes first"


def test_reports_of_the_longest_texts_go_up_too(summary: RelaySummary, roster: Roster) -> None:
    for member in known(summary, roster, 12):
        summary.pass_up(member, Heartbeat(member.number, LONGEST), 0)
    assert len(summed(summary, 0)) == 12


def test_a_lost_member_is_reported_until_the_parent_has_removed_it(
    summary: RelaySummary, roster: Roster
) -> None:
    (member,) = known(summary, roster, 1)
    roster.mark_lost(member, "silent for 2 s")
    for turn in range(3):
        summary.handle_timer(turn * REPORT_INTERVAL_NS)
        assert said(summary) == [MemberReports(((101, member.report),))]
    summary.note_unknown(101)
    assert summed(summary, 4 * REPORT_INTERVAL_NS) == []


def test_the_earlier_instance_of_a_restarted_member_is_reported_lost(
    summary: RelaySummary, roster: Roster
) -> None:
    (member,) = known(summary, roster, 1)
    roster.mark_lost(member, "silent for 2 s")
    again = admitted(roster, "cam1", 77)
    summary.pass_up(again, Hello("cam1", 77, CAMERA), 0)
    assert said(summary) == [Hello("cam1", 77, CAMERA, "hall")]
    # Else the parent, which hears the relay, would keep the name for it.
    for turn in range(2):
        assert summed(summary, turn * REPORT_INTERVAL_NS) == [101]
    summary.note_unknown(101)
    assert summed(summary, 3 * REPORT_INTERVAL_NS) == []


def test_answers_to_a_trigger_go_up_together_but_for_those_that_refuse(
    summary: RelaySummary, roster: Roster
) -> None:
    members = known(summary, roster, 300)
    for member in members:
        refusal = "no room" if member.instance % 100 == 0 else ""
        summary.pass_up(member, TriggerAck(member.number, 1, 2, refusal), S)
    assert summary.next_timer() <= S + ACK_BATCH_NS
    summary.handle_timer(S + ACK_BATCH_NS)
    acks = [one for one in said(summary) if isinstance(one, TriggerAck)]
    numbers: dict[str, list[int]] = {refusal: [] for refusal in ("", "no room")}
    for ack in acks:
        numbers[ack.refusal] += [ack.client, *ack.others]
    assert len(acks) == 3
    assert [len(found) for found in numbers.values()] == [297, 3]
    assert sorted(numbers[""] + numbers["no room"]) == [100 + member.instance for member in members]
    summary.pass_up(members[0], TriggerAck(members[0].number, 1, 3), 2 * S)
    summary.handle_timer(2 * S + ACK_BATCH_NS)
    assert [one for one in said(summary) if isinstance(one, TriggerAck)] == [TriggerAck(101, 1, 3)]


def test_whoever_is_below_a_further_relay_keeps_that_relay_as_its_place(
    summary: RelaySummary, roster: Roster
) -> None:
    member = admitted(roster, "cam", 7, via="attic")
    summary.pass_up(member, Heartbeat(member.number, REPORT), 0)
    assert said(summary) == [Hello("cam", 7, CAMERA, "attic")]


def test_nodes_that_only_keep_the_time_are_nobodys_business_above(
    summary: RelaySummary, roster: Roster
) -> None:
    member = admitted(roster, "clock", 7, kind=CLOCK_ONLY)
    assert not summary.pass_up(member, Heartbeat(member.number, REPORT), 0)
    assert said(summary) == []


def test_without_a_parent_nothing_goes_up_and_after_one_everybody_is_introduced_anew(
    summary: RelaySummary, roster: Roster
) -> None:
    member = admitted(roster, "cam", 7)
    summary.pass_up(member, Heartbeat(member.number, REPORT), 0)
    summary.note_welcome(7, 99, roster.members)
    summary.restart(has_parent=False)
    assert not summary.pass_up(member, Heartbeat(member.number, REPORT), 0)
    summary.restart(has_parent=True)
    assert summary.member(99) is None
    summary.pass_up(member, Heartbeat(member.number, REPORT), 0)
    assert said(summary) == [Hello("cam", 7, CAMERA, "hall")]


def test_a_client_that_the_parent_refused_is_given_up_until_it_is_welcome(
    summary: RelaySummary, roster: Roster
) -> None:
    member = admitted(roster, "cam", 7)
    hello = Hello("cam", 7, CAMERA)
    summary.pass_up(member, hello, 0)
    assert summary.note_refusal(7, "another camera named cam is here", roster.members) is member
    roster.mark_lost(member, "refused")
    assert summary.refusal(hello) == "another camera named cam is here"
    assert said(summary) == [Hello("cam", 7, CAMERA, "hall")] * 2, "the parent is asked again"
    summary.note_welcome(7, 99, roster.members)
    assert summary.refusal(hello) == ""
    assert summary.member(99) is None, "it is not here yet"


def test_what_another_machine_is_refused_drops_nobody(summary: RelaySummary, roster: Roster) -> None:
    roster.admit(Hello("cam", 7, CAMERA, pin="own"), ("10.0.0.2", 5), 0)
    summary.ask(Hello("cam", 7, CAMERA, pin="thief"))
    assert summary.note_refusal(7, "two machines are called cam", roster.members) is None


def test_what_a_namesake_is_refused_does_not_drop_the_member(summary: RelaySummary, roster: Roster) -> None:
    admitted(roster, "cam", 7)
    summary.ask(Hello("cam", 8, CAMERA))
    assert summary.note_refusal(8, "another camera named cam is here", roster.members) is None


def test_a_description_that_would_not_fit_with_the_relays_name_is_refused() -> None:
    summary = RelaySummary("r" * 64)
    camera = structs.replace(CAMERA, model="ü" * 200, kind="ü" * 200, pixel_format="p" * 100)
    size = len(encode(Hello("cam", 7, camera)))
    camera = structs.replace(camera, pixel_format="p" * (100 + MAX_DATAGRAM - size))
    hello = Hello("cam", 7, camera)
    assert len(encode(hello)) <= MAX_DATAGRAM
    assert summary.refusal(hello) == DESCRIPTION_TOO_LONG
    assert summary.refusal(Hello("cam", 7, CAMERA)) == ""


def test_names_that_are_made_up_fill_no_memory(roster: Roster) -> None:
    summary = RelaySummary("hall", max_members=3)
    summary.restart(has_parent=True)
    for instance in range(20):
        summary.pass_up(
            admitted(roster, f"cam{instance}", instance), Hello(f"cam{instance}", instance, CAMERA), 0
        )
        summary.note_refusal(instance, "no", roster.members)
        summary.pass_up(admitted(roster, f"more{instance}", 100 + instance), Hello("x", 1, CAMERA), 0)
    assert len(summary._introduced) + len(summary._refused) <= 6
