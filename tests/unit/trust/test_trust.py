"""A process's trust: whose it is, what its children get, and what it adopts of its leader's."""

from pathlib import Path

import pytest

from capture_app.common.pairing_codes import Role
from capture_app.trust.known_machines import CameraNames, KnownMachine
from capture_app.trust.trust import ANYBODY, OPEN_VARIABLE, UNKNOWN_PEER, Peer, Trust


def test_a_process_has_its_users_trust_unless_another_is_in_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("capture_app.trust.trust.user_data_path", lambda *_, **__: tmp_path)
    users, other = Trust.of_user(), Trust(tmp_path / "other")
    assert users.folder == tmp_path / "trust"
    assert Trust.of_user() is users
    with other.in_use():
        assert Trust.of_user() is other
        with Trust.open().in_use():
            assert Trust.of_user().is_open
        assert Trust.of_user() is other
    for value, is_open in (("1", True), ("0", False), ("", False)):
        monkeypatch.setenv(OPEN_VARIABLE, value)
        assert Trust.of_user().is_open is is_open
    assert (Trust.open().variables, other.variables) == ({OPEN_VARIABLE: "1"}, {})


def test_who_a_peer_is_depends_on_its_key(tmp_path: Path) -> None:
    own, other = Trust(tmp_path / "own"), Trust(tmp_path / "other")
    shown = other.identity.certificate
    assert own.peer(None) == UNKNOWN_PEER
    assert own.peer(shown) == Peer(other.identity.pin)
    own.known.add(other.identity.pin, Role.RELAY, name="gate", roots=("root",))
    assert own.peer(shown) == Peer(other.identity.pin, "gate", frozenset({Role.RELAY}))
    assert own.peer(own.identity.certificate).roles == frozenset(Role)
    assert Trust.open().peer(shown) == Trust.open().peer(None) == ANYBODY
    assert own.roots_of(other.identity.pin) == ("root",)
    assert own.roots_of("unknown") == Trust.open().roots_of(other.identity.pin) == ()


@pytest.mark.parametrize("role", [Role.LEADER, Role.STANDBY])
def test_names_are_adopted_of_a_leader_that_is_a_standby_here_and_those_here_stay(
    tmp_path: Path, role: Role
) -> None:
    own, leader = Trust(tmp_path / "own"), Trust(tmp_path / "leader")
    names = CameraNames(tmp_path / "own")
    names.owners["left"] = "own pin"
    names.keep()
    own.known.add(leader.identity.pin, role)
    standby = KnownMachine(pin="standby", name="desk", roles=(Role.LEADER,))
    own.take_trust_of(own.peer_of(leader.identity.pin), [standby], {"left": "theirs", "right": "right pin"})
    assert own.peer_of("standby").name == "desk"
    adopted = {"right": "right pin"} if role is Role.STANDBY else {}
    assert CameraNames(tmp_path / "own").owners == {"left": "own pin"} | adopted


def test_a_machine_adopts_nothing_of_its_own_leader(tmp_path: Path) -> None:
    own = Trust(tmp_path)
    own.take_trust_of(own.peer_of(own.identity.pin), [], {"left": "pin"})
    assert CameraNames(tmp_path).owners == {}
