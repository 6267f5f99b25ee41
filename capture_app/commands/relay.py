"""`capture-app relay`: connect nodes that cannot reach the leader themselves."""

import asyncio
from typing import TYPE_CHECKING

import click

from capture_app.commands.leader_choice import make_known, pairing_options
from capture_app.commands.shared_options import (
    ADDRESS,
    clock_option,
    host_option,
    name_option,
    open_option,
    port_option,
    run_until_stopped,
)
from capture_app.common.address import Address
from capture_app.common.clock import parse_clock
from capture_app.console.terminal import json_option, log_line, print_json_line, talk
from capture_app.console.usage import examples

if TYPE_CHECKING:
    from capture_app.node.endpoint import PortOptions


@click.command(epilog=examples("capture-app relay 192.168.1.20 --name gate"))
@click.argument("parents", nargs=-1, required=True, type=ADDRESS, metavar="LEADER...")
@name_option("Name of this relay.")
@host_option
@port_option
@clock_option
@pairing_options
@open_option
@json_option
def relay(
    parents: tuple[Address, ...],
    name: str,
    host: str,
    port: int,
    clock_text: str,
    pin: str | None,
    code: str | None,
    as_json: bool,
) -> None:
    """Run a relay until Ctrl-C; nodes join it like a leader.

    LEADER is the address of the leader or of another relay. Give several of the same rig for failover,
    preferred first. The relay forwards the leader's time and bursts to its nodes, and their images to the
    leader. `status` and `burst` accept its address, too. If no leader answers, it keeps time by itself
    (holdover).
    """
    from capture_app.node.endpoint import PortOptions
    from capture_app.protocol.log import Log

    make_known(parents, pin, code)
    options = PortOptions(
        host=host,
        port=port,
        clock=parse_clock(clock_text, node=name),
        log=Log(lambda line: log_line(f"{name}: {line}")),
    )
    run_until_stopped(_run_relay(name, parents, options, as_json))


async def _run_relay(name: str, parents: tuple[Address, ...], options: "PortOptions", as_json: bool) -> None:
    from capture_app.node.relay_node import RelayNode

    async with (
        await RelayNode.start(name, parents, options) as node,
        node.announced(name=name),
    ):
        talk(f"relay at {node.address}, below {', or '.join(map(str, parents))}")
        talk(f"join with: capture-app node --leader {node.address} --camera SPEC")
        if node.also:
            talk(f"or at {', '.join(map(str, node.also))}, whichever the nodes can reach")
        if as_json:
            print_json_line(
                {
                    "event": "listening",
                    "name": name,
                    "relay": str(node.address),
                    "port": node.address.port,
                }
            )
        await asyncio.Event().wait()
