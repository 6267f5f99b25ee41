"""People in 3D for other programs: what an OSC receiver gets, and what is said in a line."""

import socket
from collections import deque
from contextlib import closing

import pytest

from capture_app.common.address import Address
from capture_app.common.errors import NetworkError
from capture_app.companions.people.people_command import facts_of
from capture_app.companions.people.people_streams import OscStream
from capture_app.session.format.live_pictures import LivePerson, PeoplePreview

packet = pytest.importorskip("pythonosc.osc_packet", reason="python-osc is not installed")

JOINTS = {"nose": (0.5, -1.25, 2.0, 0.0625), "left_hip": (1.0, 0.0, 0.5, 0.03125)}
FOUND = PeoplePreview(
    10**9,
    "",
    late_ns=250_000_000,
    people=(LivePerson(2, JOINTS),),
    joints=("nose", "left_hip", "right_hip"),
    unit="m",
    absent={"cam2": "syncing"},
)


def test_a_receiver_gets_each_joint_with_its_error() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(5)
        with closing(OscStream(Address(*receiver.getsockname()))) as stream:
            stream.send(FOUND)
        first, *joints = packet.OscPacket(receiver.recv(65536)).messages
    assert (first.message.address, first.message.params) == ("/simulshot/people", [1, 0.25])
    got = {one.message.address: tuple(one.message.params) for one in joints}
    assert got == {f"/simulshot/2/{joint}": row for joint, row in JOINTS.items()}
    assert {one.time for one in joints} == {first.time}


def test_an_unknown_host_is_an_error() -> None:
    with (
        closing(OscStream(Address("nowhere.invalid", 9000))) as stream,
        pytest.raises(NetworkError, match=r"cannot send OSC to nowhere\.invalid:9000"),
    ):
        stream.send(FOUND)


def test_a_line_says_who_is_there_how_sure_and_without_whom() -> None:
    line = FOUND.described(deque([0.0, 0.125, 0.25]), {"cam2": "Böhm"})
    assert line == "1 person; 2 joints, 95 % error 0.0469 m; 8.0 a second, 250 ms late; without Böhm: syncing"
    assert PeoplePreview(0, "", problem="the rig is not calibrated").described(deque(), {}) == (
        "the rig is not calibrated"
    )
    assert PeoplePreview(0, "").described(deque([0.0]), {}) == "0 people"


def test_json_has_every_joint() -> None:
    facts = facts_of(FOUND)
    assert facts["people"] == {2: JOINTS}
    assert (facts["leader_ns"], facts["unit"], facts["absent"]) == (10**9, "m", {"cam2": "syncing"})
