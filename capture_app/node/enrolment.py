"""Pairing of machines: the leader's or relay's side, the joining machine's side, and refusals."""

import asyncio
import socket
from typing import Any

from capture_app.common import system
from capture_app.common.address import Address
from capture_app.common.errors import BadInputError, SimulshotError, UnknownMachineError
from capture_app.common.names import name_like
from capture_app.common.pairing_codes import Role, pin_of
from capture_app.net.asking import ask
from capture_app.net.channel import Channel, connect
from capture_app.protocol import messages, pairing_messages
from capture_app.protocol.log import Log
from capture_app.sync.rig.roster import Member
from capture_app.sync.wire.datagrams import Principal
from capture_app.trust.known_machines import CameraNames
from capture_app.trust.sealed_engines import SealedLeader, SealedRelay
from capture_app.trust.spake2_exchange import GOOD_FOR_S, Candidate, Invitations
from capture_app.trust.trust import Peer, Trust

OPEN_NEEDS_NO_CODE = "this rig is open: any machine may join without a code"
LOOK_EVERY_NS = 1_000_000_000
MAX_ROOTS = 20
SAID_AGAIN_S = 30.0
"""Minimum interval between log lines about unknown machines, so that they cannot flood a screen."""
Asked = (
    pairing_messages.FromUnknown | pairing_messages.Invite | pairing_messages.SpeaksFor | messages.KeyRequest
)
"""Requests that leaders and relays answer in the same way."""


class Enrolment:
    """Enrolment of machines that have a code or whose pin was added here; also grants their nodes keys."""

    def __init__(self, trust: Trust, log: Log, sealed: SealedLeader) -> None:
        """Create the enrolment of a leader or relay, whose datagrams are `sealed` unless the rig is open."""
        self._trust, self._event_log = trust, log
        self._sealed = None if trust.is_open else sealed
        self._is_relay = isinstance(sealed, SealedRelay)
        self._seen_version: int | None = None
        self._standbys: set[str] = set()
        self._due_ns: int | None = None
        self._invitations = Invitations(system.monotonic_s)
        self._said_s = -SAID_AGAIN_S
        self._name = name_like(socket.gethostname().split(".")[0], "leader")

    def look(self, now_ns: int) -> None:
        """Log refused datagrams, and revoke keys of machines that are no longer known.

        It acts once per `LOOK_EVERY_NS`. `now_ns` is the node's own clock.
        """
        if self._sealed is None or (self._due_ns is not None and now_ns < self._due_ns):
            return
        self._due_ns = now_ns + LOOK_EVERY_NS
        for refused in self._sealed.refusals.take_events(now_ns):
            self._event_log.note(refused)
        self._take_back(self._sealed)

    def _take_back(self, sealed: SealedLeader) -> None:
        """Revoke the keys of machines no longer known, and all keys when the standbys have changed."""
        try:
            machines, version = self._trust.known.all(), self._trust.known.version
        except SimulshotError:
            # A damaged file is reported where machines are enrolled.
            return
        if version != self._seen_version:
            self._seen_version = version
            may_join = {machine.pin for machine in machines if {Role.CAMERA, Role.RELAY} & {*machine.roles}}
            # The answer to a request for a new key lists the standbys.
            standbys = {machine.pin for machine in machines if Role.STANDBY in machine.roles}
            if standbys != self._standbys:
                may_join = set()
            self._standbys = standbys
            sealed.keys.revoke_all_but({self._trust.identity.pin, *may_join})
            sealed.set_direct_pins(
                self._trust.identity.pin,
                (
                    machine.pin
                    for machine in machines
                    if Role.CAMERA in machine.roles and Role.RELAY not in machine.roles
                ),
            )

    def invite(self, role: Role) -> pairing_messages.Invited:
        """Create a code for one machine. Raises UnknownMachineError where machines need none."""
        if self._trust.is_open:
            raise UnknownMachineError(OPEN_NEEDS_NO_CODE, hint="start the other machine with --open")
        return pairing_messages.Invited(code=self._invitations.invite(role).code, good_for_s=GOOD_FOR_S)

    async def answer(self, channel: Channel[Any], message: Asked) -> None:
        """Answer a machine that requests enrolment or a key, or an operator who invites one.

        Raises UnknownMachineError, BadInputError, DiskError, and NetworkError where the stream breaks off.
        """
        match message:
            case pairing_messages.EnrolRequest():
                await self._answer_enrolment(channel, message)
            case pairing_messages.PairingMessage():
                await self._answer_spake2(channel, message)
            case pairing_messages.PairingProof():
                raise UnknownMachineError("a proof must follow a pairing message")
            case pairing_messages.Invite():
                await channel.send(self.invite(message.role))
            case pairing_messages.SpeaksFor():
                # A relay speaks for a camera or an operator, never for another relay.
                channel.who = Peer(
                    message.pin,
                    message.name,
                    frozenset(message.roles) & {Role.CAMERA, Role.OPERATOR},
                    via=channel.who.pin,
                    node=message.node,
                )
            case messages.KeyRequest():
                await channel.send(self.hand_out(channel.who, message))

    def hand_out(self, who: Peer, request: messages.KeyRequest) -> messages.KeyAnswer:
        """Grant a key to a node of a machine that may request it.

        Raises BadInputError where datagrams are not sealed, UnknownMachineError where that machine was
        removed since it opened its stream.
        """
        if self._sealed is None:
            raise BadInputError(
                "this rig does not seal its datagrams",
                hint="it runs with --open: start this machine with --open too",
            )
        role = Role.RELAY if request.is_relay else Role.CAMERA
        if not self._trust.peer_of(who.pin).may(role):
            raise UnknownMachineError(
                f"this machine is no longer known here as {role}",
                hint=f"pair it again; on the leader's machine: capture-app trust invite --as {role}",
            )
        self._take_back(self._sealed)
        names = CameraNames(self._trust.folder).owners if who.may(Role.STANDBY) and self._trust.folder else {}
        return messages.KeyAnswer(
            grant=self._sealed.keys.grant(
                Principal(request.name, request.instance, who.pin, request.is_relay)
            ),
            machines=self._trust.known.vouched_for(who.pin),
            names=names,
        )

    async def _answer_enrolment(self, channel: Channel[Any], message: pairing_messages.EnrolRequest) -> None:
        known = None if self._trust.is_open else self._trust.known.find(pin_of(message.certificate))
        machine = None if known is None else self._trust.known.note_certificate(message.certificate)
        if machine is None:
            now_s = system.monotonic_s()
            if now_s - self._said_s >= SAID_AGAIN_S:
                self._said_s = now_s
                self._event_log.say(
                    f"a machine at {channel.peer.host} wants to join and is not known here;"
                    " if it is yours, show it a code: capture-app trust invite"
                )
            raise UnknownMachineError(
                "the leader does not know this machine",
                hint="on the leader's machine: capture-app trust invite",
            )
        if machine != known:
            self._event_log.say(f"{machine.name} is now known")
        await channel.send(
            pairing_messages.Known(leader=self._name, roles=machine.roles, roots=self._roots())
        )

    async def _answer_spake2(self, channel: Channel[Any], message: pairing_messages.PairingMessage) -> None:
        if self._trust.is_open:
            raise UnknownMachineError(OPEN_NEEDS_NO_CODE, hint="start this machine with --open")
        own_pin, pin = self._trust.identity.pin, pin_of(message.certificate)
        # The computation takes a while, and other nodes request the time meanwhile.
        spake2_message, invitation, key = await asyncio.to_thread(
            self._invitations.answer, pin, message.spake2_message, own_pin, message.digit
        )
        await channel.send(pairing_messages.PairingAnswer(spake2_message=spake2_message))
        said = await channel.receive_header()
        if not isinstance(said, pairing_messages.PairingProof):
            raise UnknownMachineError("a pairing message must be followed by its proof")
        try:
            proof = self._invitations.accept(invitation, key, said.proof)
        except UnknownMachineError:
            self._event_log.say(f"a machine at {channel.peer.host} tried a wrong code")
            raise
        role = invitation.role
        machine = self._trust.known.add(pin, role, name=message.name, certificate=message.certificate)
        self._event_log.say(f"{machine.name} at {channel.peer.host} is now known as {role}")
        await channel.send(
            pairing_messages.Known(leader=self._name, roles=machine.roles, proof=proof, roots=self._roots())
        )

    def _roots(self) -> tuple[str, ...]:
        """Return the pins of the leaders above this relay, or of their standbys; none for a leader."""
        roots = dict.fromkeys(
            pin
            for machine in self._trust.known.all()
            if Role.LEADER in machine.roles
            for pin in machine.roots or (machine.pin,)
        )
        return tuple(roots)[:MAX_ROOTS] if self._is_relay else ()


def is_node(who: Peer, member: Member | None, instance: int) -> bool:
    """Return whether a peer is the machine from which this run of a node joined, even if the node is lost."""
    if member is None or member.instance != instance or (who.via and who.node != (member.name, instance)):
        return False
    return member.principal is None or (member.principal.pin, member.pin) == (who.via or who.pin, who.pin)


async def is_known(leader: Address, trust: Trust) -> bool:
    """Return whether this machine and a leader know each other. Raises NetworkError if none answers."""
    try:
        async with await connect(leader, messages.FromLeader, trust=trust):
            return True
    except UnknownMachineError:
        return False


async def ask_to_enrol(leader: Address, trust: Trust) -> None:
    """Present this machine's certificate to a known leader, where its pin may have been added.

    Raises UnknownMachineError where it was not, or the leader is not known here, NetworkError.
    """
    async with await connect(leader, messages.FromLeader, trust=trust, as_unknown=True) as channel:
        if not channel.who.may(Role.LEADER):
            raise UnknownMachineError(
                f"this machine does not know the leader at {leader}",
                hint=f"pair them: capture-app trust pair {leader}",
            )
        known = await ask(
            channel,
            pairing_messages.EnrolRequest(certificate=trust.identity.certificate),
            pairing_messages.Known,
        )
        if known.roots and not trust.roots_of(channel.who.pin):
            trust.known.add(channel.who.pin, Role.LEADER, roots=known.roots)


async def pair(leader: Address, code: str, trust: Trust) -> tuple[Role, ...]:
    """Pair this machine and a leader by a code, and return this machine's roles there.

    Raises UnknownMachineError for a wrong code, NetworkError, DiskError.
    """
    own = trust.identity
    async with await connect(leader, messages.FromLeader, trust=trust, as_unknown=True) as channel:
        shown = channel.who.pin
        candidate = await asyncio.to_thread(Candidate, code, own.pin, shown)
        message = pairing_messages.PairingMessage(
            certificate=own.certificate,
            name=name_like(socket.gethostname().split(".")[0], "machine"),
            spake2_message=candidate.spake2_message,
            digit=code[:1],
        )
        answer = await ask(channel, message, pairing_messages.PairingAnswer)
        proof = await asyncio.to_thread(candidate.prove, answer.spake2_message)
        known = await ask(channel, pairing_messages.PairingProof(proof=proof), pairing_messages.Known)
        candidate.check(known.proof)
    # A leader that returns follows the standby that leads in its place, so the standby grants it that role.
    role = Role.STANDBY if Role.STANDBY in known.roles else Role.LEADER
    trust.known.add(shown, role, name=known.leader, roots=known.roots)
    return known.roles
