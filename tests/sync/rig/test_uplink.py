"""What a relay says for its members, message by message."""

import random

import pytest
from msgspec import structs

from capture_app.sync.rig.roster import Member, Roster
from capture_app.sync.rig.uplink import TOO_LONG, Uplink
from capture_app.sync.wire.codec import MAX_DATAGRAM, decode, encode
from capture_app.sync.wire.messages import (
    CLOCK_ONLY,
    Goodbye,
    Heartbeat,
    Hello,
    NodeState,
    Report,
    TriggerAck,
)
from tests.facts import make_facts

CAMERA = make_facts()
REPORT = Report(state=NodeState.READY)


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


def test_a_member_is_introduced_first_and_then_speaks_under_the_parents_number(
    uplink: Uplink, roster: Roster
) -> None:
    member = admitted(roster, "cam", 7)
    assert not uplink.pass_up(member, Heartbeat(member.number, REPORT)), "the relay answers meanwhile"
    assert said(uplink) == [Hello("cam", 7, CAMERA, "hall")]
    uplink.note_welcome(7, 99, roster.members)
    assert uplink.member(99) is member
    assert uplink.pass_up(member, Heartbeat(member.number, REPORT)), "the answer comes from above"
    assert not uplink.pass_up(member, TriggerAck(member.number, 1, 2))
    assert not uplink.pass_up(member, Goodbye(member.number))
    assert said(uplink) == [Heartbeat(99, REPORT), TriggerAck(99, 1, 2), Goodbye(99)]


def test_whoever_is_below_a_further_relay_keeps_that_relay_as_its_place(
    uplink: Uplink, roster: Roster
) -> None:
    member = admitted(roster, "cam", 7, via="attic")
    uplink.pass_up(member, Heartbeat(member.number, REPORT))
    assert said(uplink) == [Hello("cam", 7, CAMERA, "attic")]


def test_nodes_that_only_keep_the_time_are_nobodys_business_above(uplink: Uplink, roster: Roster) -> None:
    member = admitted(roster, "clock", 7, kind=CLOCK_ONLY)
    assert not uplink.pass_up(member, Heartbeat(member.number, REPORT))
    assert said(uplink) == []


def test_without_a_parent_nothing_goes_up_and_after_one_everybody_is_introduced_anew(
    uplink: Uplink, roster: Roster
) -> None:
    member = admitted(roster, "cam", 7)
    uplink.pass_up(member, Heartbeat(member.number, REPORT))
    uplink.note_welcome(7, 99, roster.members)
    uplink.restart(has_parent=False)
    assert not uplink.pass_up(member, Heartbeat(member.number, REPORT))
    uplink.restart(has_parent=True)
    assert uplink.member(99) is None
    uplink.pass_up(member, Heartbeat(member.number, REPORT))
    assert said(uplink) == [Hello("cam", 7, CAMERA, "hall")]


def test_a_client_that_the_parent_refused_is_given_up_until_it_is_welcome(
    uplink: Uplink, roster: Roster
) -> None:
    member = admitted(roster, "cam", 7)
    hello = Hello("cam", 7, CAMERA)
    uplink.pass_up(member, hello)
    assert uplink.note_refusal(7, "another camera named cam is here", roster.members) is member
    roster.mark_lost(member, "refused")
    assert uplink.refusal(hello) == "another camera named cam is here"
    assert said(uplink) == [Hello("cam", 7, CAMERA, "hall")] * 2, "the parent is asked again"
    uplink.note_welcome(7, 99, roster.members)
    assert uplink.refusal(hello) == ""
    assert uplink.member(99) is None, "it is not here yet"


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
    uplink = Uplink("hall", most_members=3)
    uplink.restart(has_parent=True)
    for instance in range(20):
        uplink.pass_up(
            admitted(roster, f"cam{instance}", instance), Hello(f"cam{instance}", instance, CAMERA)
        )
        uplink.note_refusal(instance, "no", roster.members)
        uplink.pass_up(admitted(roster, f"more{instance}", 100 + instance), Hello("x", 1, CAMERA))
    assert uplink.remembered <= 6
