"""A machine's identity and the machines that it knows, on the disk."""

import asyncio
import errno
import os
import stat
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest
from msgspec.structs import replace

from capture_app.common import system
from capture_app.common.errors import BadInputError, DiskError
from capture_app.common.pairing_codes import Role, parse_pin, pin_of
from capture_app.trust.identity import is_proven, load_identity, sign
from capture_app.trust.known_machines import CameraNames, KnownMachines
from capture_app.trust.trust import Trust


def certificate(folder: Path) -> bytes:
    return load_identity(folder).certificate


def test_an_identity_is_made_once_and_only_its_user_can_read_it(tmp_path: Path) -> None:
    made = load_identity(tmp_path / "a" / "trust")
    assert load_identity(tmp_path / "a" / "trust") == made
    assert stat.S_IMODE(made.file.stat().st_mode) == 0o600
    assert stat.S_IMODE(made.file.parent.stat().st_mode) == 0o700
    assert made.pin == pin_of(made.certificate)
    assert load_identity(tmp_path / "b").pin != made.pin


def test_processes_that_begin_together_have_one_identity(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from capture_app.trust.identity import load_identity\n"
        f"sys.stdin.read(); print(load_identity(Path({str(tmp_path / 'trust')!r})).pin)"
    )
    begun = [
        subprocess.Popen(
            [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for _ in range(4)
    ]
    for process in begun:
        assert process.stdin is not None
        process.stdin.close()
    pins = set()
    for process in begun:
        assert process.stdout is not None
        with process:
            pins.add(process.stdout.read())
    assert len(pins) == 1
    assert [path.name for path in (tmp_path / "trust").iterdir()] == ["identity.pem"]


@pytest.mark.parametrize("damage", [b"", b"-----BEGIN CERTIFICATE-----\nnothing", b"\xff\xfe"])
def test_a_damaged_identity_is_said(tmp_path: Path, damage: bytes) -> None:
    load_identity(tmp_path).file.write_bytes(damage)
    with pytest.raises(BadInputError, match="does not contain a key and its certificate"):
        load_identity(tmp_path)


def test_a_folder_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DiskError, match="cannot store this machine's key"):
        load_identity(tmp_path / "file" / "trust")


@pytest.mark.parametrize("is_there", [False, True])
def test_an_identity_needs_no_links_and_replaces_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_there: bool
) -> None:
    """Android's storage has no links; another process may make the key at the same moment."""
    faster = load_identity(tmp_path / "faster").file.read_bytes()

    def link(_: Path, path: Path) -> None:
        if is_there:
            path.write_bytes(faster)
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(os, "link", link)
    made = load_identity(tmp_path / "own")
    assert (made.file.read_bytes() == faster) is is_there
    assert [path.name for path in made.file.parent.iterdir()] == ["identity.pem"]
    monkeypatch.setattr(os, "link", Mock(side_effect=OSError(errno.ENOSPC, "No space left on device")))
    with pytest.raises(DiskError, match="No space left on device"):
        load_identity(tmp_path / "another")
    assert not [*(tmp_path / "another").iterdir()]


def test_an_identity_is_whole_on_the_disk_before_it_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[int] = []
    monkeypatch.setattr(system, "sync_data", lambda handle: synced.append(os.fstat(handle).st_size))
    link = os.link

    def put(part: Path, path: Path) -> None:
        assert synced == [part.stat().st_size]
        link(part, path)

    monkeypatch.setattr(os, "link", put)
    assert load_identity(tmp_path).file.stat().st_size == synced[0]


def test_a_pin_is_read_as_people_paste_it(tmp_path: Path) -> None:
    pin = load_identity(tmp_path).pin
    assert len(pin.replace("-", "")) == 32
    for text in (pin, pin.upper(), pin.replace("-", ""), f" {pin.replace('-', ' ')}\n"):
        assert parse_pin(text) == pin
    for text in ("", pin[:-1], pin + "a", "0" + pin[1:], "é" + pin[1:]):
        with pytest.raises(BadInputError, match="is not a pin"):
            parse_pin(text)


def test_machines_are_known_by_what_they_may_do_until_they_are_removed(tmp_path: Path) -> None:
    known, elsewhere = KnownMachines(tmp_path / "here"), KnownMachines(tmp_path / "here")
    one, two = certificate(tmp_path / "one"), certificate(tmp_path / "two")
    assert known.all() == ()
    known.add(pin_of(one), Role.CAMERA, name="pi", certificate=one)
    known.add(pin_of(two), Role.CAMERA, name="pi", certificate=two)
    machine = known.add(pin_of(one), Role.OPERATOR)
    assert (machine.name, machine.roles, machine.certificate) == ("pi", (Role.CAMERA, Role.OPERATOR), one)
    assert {machine.name for machine in elsewhere.all()} == {"pi", "pi-2"}, "another process sees it"
    with pytest.raises(BadInputError, match="no machine here"):
        known.remove("p")
    known.remove("pi")
    assert known.remove(pin_of(two)[:9]).name == "pi-2"
    assert elsewhere.all() == ()


def test_a_machine_that_was_added_by_its_pin_shows_its_certificate_later(tmp_path: Path) -> None:
    known, shown = KnownMachines(tmp_path / "here"), certificate(tmp_path / "one")
    assert known.note_certificate(shown) is None, "a stranger is not kept"
    known.add(pin_of(shown), Role.CAMERA)
    noted = known.note_certificate(shown)
    assert noted is not None
    assert (noted.certificate, noted.roles) == (shown, (Role.CAMERA,))
    assert known.all() == (noted,)
    version = known.version
    assert known.note_certificate(shown) == noted
    known.all()
    assert known.version == version, "it is stored once"


def test_what_is_no_certificate_is_not_kept(tmp_path: Path) -> None:
    known, one, two = KnownMachines(tmp_path), certificate(tmp_path / "one"), certificate(tmp_path / "two")
    for shown, pin in ((b"nothing", pin_of(b"nothing")), (b"", pin_of(b"")), (one, pin_of(two))):
        with pytest.raises(BadInputError):
            known.add(pin, Role.CAMERA, certificate=shown)
    assert known.all() == ()


@pytest.mark.parametrize("tail", [b"0", b"0\x82", b"\0", None], ids=["one", "two", "zero", "another"])
def test_a_machine_that_shows_more_than_its_certificate_keeps_no_other_out(
    tmp_path: Path, tail: bytes | None
) -> None:
    """OpenSSL loads such a thing alone, and not in a row with those of others."""
    leader, one, two = Trust(tmp_path / "leader"), certificate(tmp_path / "1"), certificate(tmp_path / "2")
    shown = one + (two if tail is None else tail)
    with pytest.raises(BadInputError, match="invalid certificate"):
        leader.known.add(pin_of(shown), Role.CAMERA, certificate=shown)
    leader.known.add(pin_of(two), Role.CAMERA, certificate=two)
    assert leader.server_context() is not None


def test_a_damaged_file_is_said(tmp_path: Path) -> None:
    (tmp_path / "machines.json").write_text('[{"pin": 1}]')
    with pytest.raises(BadInputError, match="is damaged"):
        KnownMachines(tmp_path).all()


def test_a_file_that_cannot_be_read_or_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "machines.json").mkdir()
    known = KnownMachines(tmp_path)
    with pytest.raises(DiskError, match="cannot read"):
        known.all()
    (tmp_path / "machines.json").rmdir()
    (tmp_path / "machines.lock").mkdir()
    with pytest.raises(DiskError, match="cannot write"):
        known.add("pin", Role.CAMERA)


async def test_changes_of_several_at_once_are_all_kept(tmp_path: Path) -> None:
    shown = [certificate(tmp_path / str(number)) for number in range(8)]
    await asyncio.gather(
        *(
            asyncio.to_thread(KnownMachines(tmp_path / "here").add, pin_of(one), Role.CAMERA, certificate=one)
            for one in shown
        )
    )
    assert {machine.pin for machine in KnownMachines(tmp_path / "here").all()} == set(map(pin_of, shown))


def test_only_who_was_let_in_as_a_standby_leads_by_the_word_of_a_leader(tmp_path: Path) -> None:
    """A camera, however it behaves, is never among those that a leader vouches for to its nodes."""
    pins = {name: load_identity(tmp_path / name).pin for name in ("leader", "standby", "cam", "evil", "me")}
    leader, node = KnownMachines(tmp_path / "leader"), KnownMachines(tmp_path / "me")
    leader.add(pins["standby"], Role.STANDBY, certificate=certificate(tmp_path / "standby"))
    leader.add(pins["evil"], Role.CAMERA, name="standby", certificate=certificate(tmp_path / "evil"))
    leader.add(pins["me"], Role.CAMERA, certificate=certificate(tmp_path / "me"))
    word = leader.vouched_for(pins["me"])
    assert [(one.pin, one.roles) for one in word] == [(pins["standby"], (Role.LEADER,))]

    node.take_trust_of(pins["leader"], word)
    assert node.all() == ()  # it was never paired with that one
    node.add(pins["evil"], Role.CAMERA)
    node.take_trust_of(pins["evil"], word)
    assert node.find(pins["standby"]) is None  # a camera's word is none
    node.add(pins["leader"], Role.LEADER)
    node.take_trust_of(pins["leader"], word)
    trusted = node.find(pins["standby"])
    assert trusted is not None
    assert trusted.roles == (Role.LEADER,)
    # Nor does whoever is known by another's word make others known.
    stranger = replace(trusted, pin=load_identity(tmp_path / "stranger").pin)
    node.take_trust_of(pins["standby"], [trusted, stranger])
    assert len(node.all()) == 3
    # What a leader says of orders and cameras does not count here: it is no standby of this machine.
    node.take_trust_of(pins["leader"], [*word, *leader.vouched_for(pins["standby"])])
    assert {one.pin: one.roles for one in node.all()} == {
        pins["evil"]: (Role.CAMERA,),
        pins["leader"]: (Role.LEADER,),
        pins["standby"]: (Role.LEADER,),
    }
    leader.remove(pins["standby"])
    node.take_trust_of(pins["leader"], leader.vouched_for(pins["me"]))
    assert node.find(pins["standby"]) is None  # taken back


def test_a_standby_knows_whom_the_leader_knows_as_long_as_that_does(tmp_path: Path) -> None:
    names = ("first", "second", "cam", "desk")
    pins = {name: load_identity(tmp_path / name).pin for name in names}
    first, second = KnownMachines(tmp_path / "first"), KnownMachines(tmp_path / "second")
    first.add(pins["second"], Role.STANDBY, certificate=certificate(tmp_path / "second"))
    second.add(pins["first"], Role.STANDBY)
    first.add(pins["cam"], Role.CAMERA, name="garage", certificate=certificate(tmp_path / "cam"))
    first.add(pins["desk"], Role.OPERATOR, name="desk")
    second.take_trust_of(pins["first"], first.vouched_for(pins["second"]))
    cam, desk = second.find(pins["cam"]), second.find(pins["desk"])
    assert cam is not None
    assert (cam.name, cam.roles, cam.certificate) == ("garage", (Role.CAMERA,), certificate(tmp_path / "cam"))
    assert desk is not None
    assert desk.roles == (Role.OPERATOR,)
    # It passes nothing on but what was confirmed with it, so that nothing goes round and comes back.
    assert [one.pin for one in second.vouched_for(pins["first"])] == []

    second.add(pins["desk"], Role.CAMERA)  # confirmed here, too
    first.remove("garage")
    first.remove("desk")
    second.take_trust_of(pins["first"], first.vouched_for(pins["second"]))
    assert second.find(pins["cam"]) is None
    desk = second.find(pins["desk"])
    assert desk is not None
    assert desk.roles == (Role.CAMERA, Role.OPERATOR)


def test_a_certificate_by_word_must_be_of_its_pin(tmp_path: Path) -> None:
    known, leader = KnownMachines(tmp_path / "a"), KnownMachines(tmp_path / "leader")
    pin = load_identity(tmp_path / "leader").pin
    known.add(pin, Role.STANDBY)
    leader.add(load_identity(tmp_path / "cam").pin, Role.CAMERA)
    forged = replace(leader.all()[0], certificate=certificate(tmp_path / "leader"))
    with pytest.raises(BadInputError, match="not match the pin"):
        known.take_trust_of(pin, [forged])


def test_what_a_leader_has_signed_is_proven_by_its_key_alone(tmp_path: Path) -> None:
    leader, other = load_identity(tmp_path / "leader"), load_identity(tmp_path / "other")
    proof = sign(leader, ("a", 1), "saved")
    assert is_proven(proof, ["x", leader.pin], ("a", 1), "saved")
    forged = (proof[0], bytes(reversed(proof[1])))
    for shown, pins, said in (
        (None, [leader.pin], "saved"),
        (proof, [other.pin], "saved"),
        (proof, [], "saved"),
        (proof, [leader.pin], "lost"),
        (forged, [leader.pin], "saved"),
        ((other.certificate, proof[1]), [leader.pin, other.pin], "saved"),
    ):
        assert not is_proven(shown, pins, ("a", 1), said)


def test_owners_of_names_that_two_leaders_store_are_all_stored(tmp_path: Path) -> None:
    one, other = CameraNames(tmp_path), CameraNames(tmp_path)
    one.owners["a"], one.owners["b"], other.owners["c"] = "pin a", "pin b", "pin c"
    assert not one.is_stored
    one.keep()
    other.keep()
    assert one.is_stored
    assert CameraNames(tmp_path).owners == {"a": "pin a", "b": "pin b", "c": "pin c"}
    del one.owners["a"]
    one.owners["b"] = "pin d"
    one.keep()
    other.keep()
    assert CameraNames(tmp_path).owners == {"b": "pin d", "c": "pin c"}


def test_what_is_stored_already_is_not_written_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = CameraNames(tmp_path)
    names.owners["a"] = "pin a"
    names.keep()
    monkeypatch.setattr("capture_app.trust.known_machines.write_atomic", pytest.fail)
    names.keep()
