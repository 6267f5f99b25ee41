"""Rights of a machine on a stream: the one role that each message requires of its sender."""

from capture_app.common.bounds import Message
from capture_app.common.errors import UnknownMachineError
from capture_app.common.pairing_codes import Role
from capture_app.protocol import messages, orders, pairing_messages, status
from capture_app.trust.trust import Peer

SENDERS: dict[Role | None, tuple[type[Message], ...]] = {
    # Any machine, paired or not: pair by a code or a pin.
    None: (pairing_messages.EnrolRequest, pairing_messages.PairingMessage, pairing_messages.PairingProof),
    # A camera: a key for its datagrams, its own streams, reports, images and previews. Its name is checked
    # where it joins and where it opens a stream.
    Role.CAMERA: (
        messages.KeyRequest,
        messages.NodeStream,
        messages.CameraReport,
        messages.ImageBatch,
        messages.SpoolSpace,
        orders.CameraHealth,
        orders.ControlsAnswer,
        orders.StampSaved,
        status.Preview,
        status.NodeDetail,
    ),
    # A relay: the messages of cameras and operators below it, on their behalf, but for `DIRECT_ONLY`.
    Role.RELAY: (pairing_messages.SpeaksFor,),
    # An operator: view the rig, take bursts, change nodes and settings, invite further machines.
    Role.OPERATOR: (
        messages.StatusRequest,
        messages.BurstRequest,
        orders.WatchRequest,
        orders.PreviewRequest,
        orders.PreviewSeen,
        orders.DetailRequest,
        orders.ControlsRequest,
        orders.SaveStamp,
        orders.AskTime,
        orders.PlaceMark,
        orders.AddCamera,
        orders.AddSimulated,
        orders.RemoveCamera,
        orders.CancelBurst,
        orders.EndBurst,
        orders.InvitePhone,
        orders.StaggerCameras,
        orders.StopRig,
        pairing_messages.Invite,
    ),
}
"""Messages to a leader or a relay, by the role required of the sender; None: no role."""

DIRECT_ONLY: tuple[type[Message], ...] = (
    messages.KeyRequest,
    pairing_messages.SpeaksFor,
    pairing_messages.Invite,
    orders.InvitePhone,
    orders.StopRig,
)
"""Messages that no relay may send for a machine below it: keys, invitations, and the rig's end."""

_REQUIRED = {kind: role for role, kinds in SENDERS.items() for kind in kinds}


def check_allowed(who: Peer, message: Message) -> None:
    """Check that a machine may send a message. Raises UnknownMachineError with the command that allows it."""
    if who.via and isinstance(message, DIRECT_ONLY):
        raise UnknownMachineError(
            "a relay may not send this for a machine below it",
            hint="use a machine that is paired with the leader itself",
        )
    is_relays = isinstance(message, messages.KeyRequest) and message.is_relay
    role = Role.RELAY if is_relays else _REQUIRED[type(message)]
    # A standby notes which cameras to expect when it takes over.
    is_standbys = isinstance(message, messages.StatusRequest) and who.may(Role.STANDBY)
    if role is not None and not who.may(role) and not is_standbys:
        known = "not known here" if who.is_unknown else f"known here as {' and '.join(sorted(who.roles))}"
        raise UnknownMachineError(
            f"this machine is {known}, not as {role}",
            hint=f"run on the leader's machine: capture-app trust invite --as {role}",
        )
