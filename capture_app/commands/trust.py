"""`capture-app trust`: the machines that this one trusts, and pairing with others."""

import asyncio
import sys
from datetime import UTC, datetime

import click

from capture_app.commands.joining import (
    PIN,
    ask_and_pair,
    code_option,
    joining_command,
    pair_with,
)
from capture_app.commands.options import ADDRESS, leader_option
from capture_app.common.address import Address
from capture_app.common.pairing_codes import Role, show_code
from capture_app.console.terminal import answer, json_option, table
from capture_app.console.usage import examples
from capture_app.rig.membership import own_machine

EXAMPLE_PIN = "abcd-efgh-ijkl-mnop-qrst-uvwx-yz23-4567"
role_option = click.option(
    "--as",
    "role",
    type=click.Choice(list(Role), case_sensitive=False),
    default=Role.CAMERA,
    help="What it may do: bring pictures, give orders, speak for those it knows, lead cameras here, or lead"
    " in this leader's place.",
)


@click.group(epilog=examples("capture-app trust list", "capture-app trust invite"))
def trust() -> None:
    """List the machines that this one knows; let others in, and take them off.

    Machines become known once, by a code or by their pins, and then for ever. Processes of one user on one
    machine need none of this.
    """


@trust.command("list", epilog=examples("capture-app trust list"))
@json_option
def list_command(as_json: bool) -> None:
    """List the machines that are known here, and this machine's own pin."""
    mine = own_machine()
    machines = mine.known.all()
    shown = [
        {"pin": one.pin, "name": one.name, "roles": one.roles, "added_unix_s": one.added_unix_s}
        | ({"vouched_by": one.vouched_by} if one.vouched_by else {})
        for one in machines
    ]
    rows = [
        (
            one.name,
            ", ".join(one.roles),
            one.pin,
            _day(one.added_unix_s),
            one.vouched_by and "its leader's word",
        )
        for one in machines
    ]
    known = [table(("machine", "may be", "pin", "since", "by"), rows)] if rows else []
    answer(
        as_json,
        {"pin": mine.identity.pin, "machines": shown},
        [f"pin of this machine: {mine.identity.pin}", *known],
        said="" if rows else "no other machine is known here",
    )


@trust.command(epilog=examples(f"capture-app trust add {EXAMPLE_PIN}"))
@click.argument("pin", type=PIN)
@role_option
@click.option("--name", default="", metavar="NAME", show_default="chosen for you", help="What to call it.")
@json_option
def add(pin: str, role: Role, name: str, as_json: bool) -> None:
    """Let the machine of PIN join here, without a code. `capture-app trust list` there shows its pin."""
    machine = own_machine().known.add(pin, Role(role), name=name)
    told = {"pin": machine.pin, "name": machine.name, "roles": machine.roles}
    answer(as_json, told, said=f"{machine.name} is known from now on, as {' and '.join(machine.roles)}")


@trust.command(epilog=examples("capture-app trust remove garage-pi"))
@click.argument("machine")
@json_option
def remove(machine: str, as_json: bool) -> None:
    """Take MACHINE off, by its name or the beginning of its pin; what it has open is broken off."""
    removed = own_machine().known.remove(machine)
    told = {"removed": removed.name, "pin": removed.pin}
    answer(as_json, told, said=f"{removed.name} is not known any more")


@trust.command(epilog=examples("capture-app trust invite", "capture-app trust invite --as operator"))
@role_option
@click.option("--qr", is_flag=True, help="Show the line to type as a QR code, too.")
@leader_option
@json_option
def invite(role: Role, qr: bool, leader: Address, as_json: bool) -> None:
    """Show a code by which one machine becomes known to a running leader."""
    from capture_app.protocol.pairing import Invite, Invited
    from capture_app.rig.link import ask_leader, ask_status

    role = Role(role)
    if role is Role.LEADER:
        raise click.UsageError("a leader invites, and is not invited")
    invited = asyncio.run(ask_leader(leader, Invite(role=role), Invited))
    line = joining_command(asyncio.run(ask_status(leader)).leader, role, invited.code)
    told = {"code": invited.code, "good_for_s": invited.good_for_s, "as": role, "join_with": line}
    there = f"for one machine, within {invited.good_for_s // 60} minutes; there: {line}"
    answer(as_json, told, [show_code(invited.code)], said=there)
    if qr and not as_json:
        import segno

        segno.make(line, error="l", boost_error=False, micro=False).terminal(sys.stdout, compact=True)


@trust.command(epilog=examples('capture-app trust pair 192.168.1.20 --code "1234 5678"'))
@click.argument("leader", type=ADDRESS)
@code_option
@json_option
def pair(leader: Address, code: str | None, as_json: bool) -> None:
    """Make this machine known to the leader at LEADER by a code, which the person there has."""
    own_machine()
    if code is None and not sys.stdin.isatty():
        raise click.UsageError("--code is needed where there is no terminal to ask on")
    roles = ask_and_pair(leader) if code is None else pair_with(leader, code)
    answer(as_json, {"leader": str(leader), "roles": roles})


def _day(unix_s: int) -> str:
    return f"{datetime.fromtimestamp(unix_s, UTC).astimezone():%Y-%m-%d}"
