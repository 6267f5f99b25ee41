"""Membership of this machine in a rig: finding leaders, and pairing with them."""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager

from capture_app.common.address import DEFAULT_PORT, Address
from capture_app.common.errors import UnknownMachineError
from capture_app.common.pairing_codes import Role
from capture_app.common.text import Talk
from capture_app.net.discovery import search_leaders
from capture_app.net.reachability import find_obstacle
from capture_app.node import enrolment
from capture_app.node.camera.device_profiles import DeviceProfiles, node_key
from capture_app.protocol.pairing_messages import FoundLeader
from capture_app.rig.process import list_rigs
from capture_app.trust.trust import Trust


def accept_any_machine() -> AbstractContextManager[None]:
    """Skip pairing while the block runs: accept any machine, and encrypt nothing."""
    return Trust.open().in_use()


def is_pairing_skipped() -> bool:
    """Return whether pairing is skipped here, by --open or SIMULSHOT_OPEN=1."""
    return Trust.of_user().is_open


def own_machine() -> Trust:
    """Return this machine's identity and the machines that it knows.

    Raises UnknownMachineError where pairing is skipped.
    """
    trust = Trust.of_user()
    if trust.is_open:
        raise UnknownMachineError(
            "pairing is skipped here", hint="leave out --open, and: unset SIMULSHOT_OPEN"
        )
    return trust


async def find_leaders(report: Talk, followed: Mapping[str, Sequence[Address]] = {}) -> list[FoundLeader]:
    """Wait until leaders of this machine or its network answer, and return them.

    Of those that were `followed`, by their keys, the last one is returned alone; else, if any leader is
    known, only known ones are. `report` gets a sentence whenever something new prevents a connection.
    """
    own = Address("127.0.0.1", DEFAULT_PORT)
    return await search_leaders(
        lambda: (*(rig.address for rig in list_rigs()), own), report, followed=followed
    )


def followed_leaders(node: str) -> Mapping[str, Sequence[Address]]:
    """Return the addresses of each leader that a node followed, by the leader's key; both newest last."""
    return DeviceProfiles().read(node_key(node)).followed


async def needs_pairing(leader: Address) -> bool:
    """Return whether a leader answers with which this machine is not paired yet.

    Raises NetworkError, and UnknownMachineError where pairing is skipped.
    """
    trust = own_machine()
    if await find_obstacle(leader, trust=Trust.open()) or await enrolment.is_known(leader, trust):
        return False
    try:
        # This machine's pin may have been added at the leader.
        await enrolment.ask_to_enrol(leader, trust)
    except UnknownMachineError:
        return True
    return not await enrolment.is_known(leader, trust)


async def pair(leader: Address, code: str) -> tuple[Role, ...]:
    """Pair this machine with a leader by a one-time code, and return this machine's roles there.

    Raises UnknownMachineError for a wrong code or where pairing is skipped, NetworkError, DiskError.
    """
    return await enrolment.pair(leader, code, own_machine())
