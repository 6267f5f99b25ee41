"""Who may send what: each message needs one role, and a relay sends some of them for nobody."""

import typing

import pytest

from capture_app.common.errors import UnknownMachineError
from capture_app.common.pairing_codes import Role
from capture_app.protocol import messages, orders, pairing_messages, status
from capture_app.protocol.permissions import check_allowed
from capture_app.trust.trust import Peer

OF_ANYBODY = {pairing_messages.EnrolRequest, pairing_messages.PairingMessage, pairing_messages.PairingProof}
OF_CAMERAS = {
    messages.KeyRequest, messages.NodeStream, messages.CameraReport, messages.ImageBatch,
    messages.SpoolSpace, orders.CameraHealth, orders.ControlsAnswer, orders.StampSaved, status.Preview,
    status.NodeDetail,
}  # fmt: skip
NEVER_BY_A_RELAY = {
    messages.KeyRequest, pairing_messages.SpeaksFor, pairing_messages.Invite, orders.InvitePhone,
    orders.StopRig,
}  # fmt: skip
KINDS = typing.get_args(messages.ToLeader)


def message_of(kind: typing.Any, **fields: object) -> typing.Any:
    """A message of which only the kind, and these fields, matter."""
    return kind(**dict.fromkeys(kind.__struct_fields__) | fields)


def needed(kind: type) -> Role | None:
    if kind in OF_ANYBODY:
        return None
    if kind is pairing_messages.SpeaksFor:
        return Role.RELAY
    return Role.CAMERA if kind in OF_CAMERAS else Role.OPERATOR


def may(who: Peer, message: typing.Any) -> bool:
    try:
        check_allowed(who, message)
    except UnknownMachineError:
        return False
    return True


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_a_message_is_taken_from_whom_it_may_come(kind: type) -> None:
    message = message_of(kind)
    role = needed(kind)
    for own in (*Role, None):
        who = Peer("pin", roles=frozenset({own} - {None}))
        is_standbys = kind is messages.StatusRequest and own is Role.STANDBY
        assert may(who, message) is (role in (None, own) or is_standbys), own
    assert may(Peer("pin", roles=frozenset(Role)), message)
    assert may(Peer("pin", roles=frozenset(Role), via="relay"), message) is (kind not in NEVER_BY_A_RELAY)


def test_a_key_to_relay_with_is_given_to_relays_alone() -> None:
    request = message_of(messages.KeyRequest, is_relay=True)
    assert [role for role in Role if may(Peer("pin", roles=frozenset({role})), request)] == [Role.RELAY]


def test_who_may_not_is_told_what_it_is_known_as_and_what_to_do() -> None:
    request = message_of(messages.BurstRequest)
    both = Peer("pin", roles=frozenset({Role.RELAY, Role.CAMERA}))
    for who, known in ((Peer("pin"), "not known here"), (both, "known here as camera and relay")):
        with pytest.raises(UnknownMachineError, match=f"this machine is {known}, not as operator") as refused:
            check_allowed(who, request)
        assert refused.value.hint.endswith("capture-app trust invite --as operator")
