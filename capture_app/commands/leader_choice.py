"""Selection of the leader that a machine joins, and pairing of the two; phones use a page."""

import asyncio
import contextlib
import sys
from collections.abc import AsyncGenerator, Awaitable, Callable, Sequence
from typing import TYPE_CHECKING

import click

from capture_app.commands.shared_options import run_until_stopped, together
from capture_app.common.address import Address
from capture_app.common.errors import NetworkError, SimulshotError, UnknownMachineError
from capture_app.common.pairing_codes import Role, parse_code, parse_pin, show_code
from capture_app.common.tasks import end
from capture_app.console.terminal import ParsedType, log_line, print_json_line, talk

if TYPE_CHECKING:
    from capture_app.protocol.orders import PhoneInvited
    from capture_app.protocol.pairing_messages import FoundLeader

CODE, PIN = ParsedType("code", parse_code), ParsedType("pin", parse_pin)
code_option = click.option(
    "--code",
    type=CODE,
    metavar="CODE",
    show_default="asked for at the terminal if needed",
    help="One-time pairing code; on the leader's machine, capture-app trust invite shows one.",
)
pairing_options = together(
    code_option,
    click.option(
        "--pin",
        type=PIN,
        metavar="PIN",
        help="Pin of the leader's machine; no other leader is followed."
        " capture-app trust list shows it there.",
    ),
)
"""The options --code and --pin of a command that joins a leader."""


def make_known(leaders: Sequence[Address], pin: str | None, code: str | None) -> None:
    """Pair this machine with those `leaders` that answer and need it; asks for a code at a terminal.

    `pin` is the leader's pin to trust, `code` a one-time code. A leader that does not answer is left to the
    node, which waits for it and prints the instructions. Raises UnknownMachineError for a wrong `code`.
    """
    from capture_app.rig import membership

    if membership.is_pairing_skipped():
        return
    if pin is not None:
        membership.own_machine().known.add(pin, Role.LEADER)
    if code is None and not sys.stdin.isatty():
        # Without a terminal the node requests to join by itself and prints the instructions.
        return
    for leader in leaders:
        try:
            needs_pairing = asyncio.run(membership.needs_pairing(leader))
            if needs_pairing and code is not None:
                pair_with(leader, code)
                code = None  # it is good once
            elif needs_pairing and sys.stdin.isatty():
                talk(f"This machine is not paired with the leader at {leader}.")
                talk(
                    "On the leader's machine, capture-app trust invite or i in the terminal UI shows a code."
                )
                ask_and_pair(leader)
        except NetworkError as error:
            if isinstance(error, UnknownMachineError):
                raise


def pair_with(leader: Address, code: str) -> tuple[Role, ...]:
    """Pair this machine with a leader by a code, print the result, and return the machine's roles there."""
    from capture_app.rig.membership import pair

    roles = asyncio.run(pair(leader, code))
    log_line(f"paired with the leader at {leader} as {' and '.join(roles)}")
    return roles


def ask_and_pair(leader: Address) -> tuple[Role, ...]:
    """Ask for codes at the terminal until one is right, and return this machine's roles there."""
    while True:
        code = click.prompt("Pairing code, 8 digits", type=CODE, err=True)
        try:
            return pair_with(leader, code)
        except UnknownMachineError as error:
            talk(str(error))


def joining_command(leader: str, role: Role, code: str) -> str:
    """Return the command to type on the machine that is to join the leader."""
    joining = {Role.CAMERA: f"node --leader {leader} --camera SPEC", Role.RELAY: f"relay {leader}"}
    return f'capture-app {joining.get(role, f"trust pair {leader}")} --code "{show_code(code)}"'


@contextlib.asynccontextmanager
async def inviting_phones(
    ask: Callable[[], Awaitable["PhoneInvited"]], as_json: bool
) -> AsyncGenerator[None, None]:
    """Show the address and QR code for the next phone, and each new one, until the block ends.

    `ask` returns the current invitation. Its first error is raised; later ones are ignored, and it is asked
    again.
    """
    shown = await ask()
    _show_phone_code(shown, as_json)

    async def keep_showing(shown: "PhoneInvited") -> None:
        while True:
            await asyncio.sleep(0.5)
            with contextlib.suppress(SimulshotError):
                if (asked := await ask()).url != shown.url:
                    shown = asked
                    _show_phone_code(shown, as_json)

    showing = asyncio.create_task(keep_showing(shown))
    try:
        yield
    finally:
        await end(showing)


def _show_phone_code(invited: "PhoneInvited", as_json: bool) -> None:
    """Print the address of the page for the next phone; at a terminal also its QR code."""
    if as_json:
        print_json_line(
            {
                "event": "invitation",
                "url": invited.url,
                "fingerprint": invited.fingerprint,
                "good_for_s": invited.good_for_s,
            }
        )
        return
    if sys.stderr.isatty():
        import segno

        segno.make(invited.url, error="l", boost_error=False, micro=False).terminal(sys.stderr, compact=True)
    talk(f"open this page on one phone within {max(1, invited.good_for_s // 60)} minutes: {invited.url}")
    talk("its browser warns once of the certificate; on an untrusted network compare its SHA-256 there:")
    talk(f"  {invited.fingerprint}")


def leaders_to_join(
    named: tuple[Address, ...], pin: str | None, code: str | None, node: str = ""
) -> tuple[Address, ...]:
    """Return the named leaders, or the leaders of the rig found in the network; pair with them.

    Of several that are found, it is the one that `node` followed last. Raises what `find_leader` and
    `make_known` raise.
    """
    if named:
        make_known(named, pin, code)
        return named
    leader = find_leader(node)
    make_known(leader.addresses[:1], pin, code)
    return leader.among or leader.addresses[:1]


def find_leader(node: str = "") -> "FoundLeader":
    """Wait until a leader of this machine or its network answers; ask at the terminal which of several.

    Without a terminal it waits for the one that `node` followed last. Raises NetworkError if there are
    several, and it followed none.
    """
    log_line("looking for a leader in this network")
    from capture_app.rig.membership import find_leaders, followed_leaders

    followed, can_ask, said = followed_leaders(node), sys.stdin.isatty(), ""
    while True:
        leaders = run_until_stopped(find_leaders(log_line, followed))
        if len(leaders) == 1 or can_ask or not followed:
            break
        if not said:
            said = "several leaders are in this network, but not the one that this node followed"
            log_line(f"{said}: waiting for it; choose another with --leader HOST:PORT")
    leader = choose_leader(leaders, can_ask=can_ask)
    log_line(f"found a leader at {leader.addresses[0]} ({leader.name})")
    return leader


def choose_leader(leaders: "Sequence[FoundLeader]", *, can_ask: bool) -> "FoundLeader":
    """Return the leader that was found; of several the one that the user names.

    Raises NetworkError if there are several and no terminal to ask at.
    """
    if len(leaders) == 1:
        return leaders[0]
    if not can_ask:
        names = ", ".join(f"{leader.addresses[0]} ({leader.name})" for leader in leaders)
        raise NetworkError(
            f"several leaders are in this network: {names}", hint="choose one with --leader HOST:PORT"
        )
    for number, offered in enumerate(leaders, 1):
        talk(
            f"{number}  {offered.addresses[0]}  {offered.name}{'' if offered.is_known else '  (not paired)'}"
        )
    which = click.IntRange(1, len(leaders))
    return leaders[click.prompt("Several leaders are here. Which", type=which, default=1, err=True) - 1]
