"""`capture-app trust`: the machines that this one trusts, and pairing with others."""

import asyncio
import sys
from datetime import UTC, datetime

import click

from capture_app.commands.leader_choice import (
    PIN,
    ask_and_pair,
    code_option,
    joining_command,
    pair_with,
)
from capture_app.commands.shared_options import ADDRESS, leader_option
from capture_app.common.address import Address
from capture_app.common.pairing_codes import Role, show_code
from capture_app.console.terminal import answer, json_option, table
from capture_app.console.usage import examples
from capture_app.rig.membership import own_machine

role_option = click.option(
    "--as",
    "role",
    type=click.Choice(list(Role), case_sensitive=False),
    default=Role.CAMERA,
    help="Role of the machine. camera: send images; operator: control the rig; relay: connect its own nodes;"
    " leader: lead cameras of this machine; standby: replace this leader.",
)


@click.group(epilog=examples("capture-app trust list", "capture-app trust invite"))
def trust() -> None:
    """List, pair and remove the machines that this one trusts.

    Two machines are paired once, by a code or by their pins. Processes of one user on one machine need no
    pairing.
    """


@trust.command("list", epilog=examples("capture-app trust list"))
@json_option
def list_command(as_json: bool) -> None:
    """List the paired machines, and this machine's own pin."""
    mine = own_machine()
    machines = mine.known.all()
    shown = [
        {
            "pin": machine.pin,
            "name": machine.name,
            "roles": machine.roles,
            "added_unix_s": machine.added_unix_s,
        }
        | ({"vouched_by": machine.vouched_by} if machine.vouched_by else {})
        for machine in machines
    ]
    rows = [
        (
            machine.name,
            ", ".join(machine.roles),
            machine.pin,
            f"{datetime.fromtimestamp(machine.added_unix_s, UTC).astimezone():%Y-%m-%d}",
            machine.vouched_by and "its leader",
        )
        for machine in machines
    ]
    known = [table(("machine", "may be", "pin", "since", "by"), rows)] if rows else []
    answer(
        as_json,
        {"pin": mine.identity.pin, "machines": shown},
        [f"pin of this machine: {mine.identity.pin}", *known],
        said="" if rows else "no machine is paired",
    )


@trust.command(epilog=examples("capture-app trust add abcd-efgh-ijkl-mnop-qrst-uvwx-yz23-4567"))
@click.argument("pin", type=PIN)
@role_option
@click.option("--name", default="", metavar="NAME", show_default="generated", help="Name of the machine.")
@json_option
def add(pin: str, role: Role, name: str, as_json: bool) -> None:
    """Trust the machine with this PIN, without a code. `capture-app trust list` there shows its pin."""
    machine = own_machine().known.add(pin, Role(role), name=name)
    answer(
        as_json,
        {"pin": machine.pin, "name": machine.name, "roles": machine.roles},
        said=f"{machine.name} is trusted as {' and '.join(machine.roles)}",
    )


@trust.command(epilog=examples("capture-app trust remove garage-pi"))
@click.argument("machine")
@json_option
def remove(machine: str, as_json: bool) -> None:
    """Remove MACHINE, by its name or the start of its pin; its open connections are closed."""
    removed = own_machine().known.remove(machine)
    answer(
        as_json,
        {"removed": removed.name, "pin": removed.pin},
        said=f"{removed.name} is no longer trusted",
    )


@trust.command(epilog=examples("capture-app trust invite", "capture-app trust invite --as operator"))
@role_option
@leader_option
@json_option
def invite(role: Role, leader: Address, as_json: bool) -> None:
    """Show a code that pairs one machine with a running leader, on a terminal also as a QR code."""
    from capture_app.protocol.pairing_messages import Invite, Invited
    from capture_app.rig.rig_link import ask_leader, ask_status

    role = Role(role)
    if role is Role.LEADER:
        raise click.UsageError("a leader cannot be invited: run invite at the leader")
    invited = asyncio.run(ask_leader(leader, Invite(role=role), Invited))
    line = joining_command(asyncio.run(ask_status(leader)).leader, role, invited.code)
    answer(
        as_json,
        {"code": invited.code, "good_for_s": invited.good_for_s, "as": role, "join_with": line},
        [show_code(invited.code)],
        said=f"pairs one machine within {invited.good_for_s // 60} minutes; type there: {line}",
    )
    if sys.stdout.isatty() and not as_json:
        import segno

        segno.make(line, error="l", boost_error=False, micro=False).terminal(sys.stdout, compact=True)


@trust.command(epilog=examples('capture-app trust pair 192.168.1.20 --code "1234 5678"'))
@click.argument("leader", type=ADDRESS)
@code_option
@json_option
def pair(leader: Address, code: str | None, as_json: bool) -> None:
    """Pair this machine with the leader at LEADER by a code shown there."""
    own_machine()
    if code is None and not sys.stdin.isatty():
        raise click.UsageError("without a terminal, give --code")
    roles = ask_and_pair(leader) if code is None else pair_with(leader, code)
    answer(as_json, {"leader": str(leader), "roles": roles})
