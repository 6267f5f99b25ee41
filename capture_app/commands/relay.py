"""`capture-app relay`: carry a leader's time, bursts and images to nodes that cannot reach the leader."""

from typing import TYPE_CHECKING

import click

from capture_app.commands.node import check_node_name, host_name
from capture_app.commands.options import (
    AddressType,
    beacons_option,
    clock_option,
    host_option,
    port_option,
    run_until_stopped,
)
from capture_app.net.address import Address
from capture_app.terminal import json_option, print_json_line, talk

if TYPE_CHECKING:
    from capture_app.node.relay import RelayNode


@click.command()
@click.argument("parents", nargs=-1, required=True, type=AddressType(), metavar="LEADER [OTHER]...")
@click.option(
    "--name",
    default=host_name,
    callback=check_node_name,
    help="Name of this relay.  [default: this host's name]",
)
@host_option
@port_option
@clock_option
@beacons_option
@json_option
def relay(
    parents: tuple[Address, ...],
    name: str,
    host: str,
    port: int,
    clock_text: str,
    reference_broadcast: bool,
    as_json: bool,
) -> None:
    """Run a relay until Ctrl-C: nodes join it as they join a leader, and are part of the leader's rig.

    LEADER is the leader or another relay; OTHER ones, of the same rig, are asked in turn when it is gone. The
    relay holds the leader's time, brings bursts to its nodes and their images to the leader. `status` and
    `burst` may be asked of it as well. Without a leader it holds the time over, and says so.
    """
    from capture_app.clock import parse_clock
    from capture_app.node.relay import RelayNode

    node = RelayNode(
        name=name,
        parents=parents,
        host=host,
        port=port,
        clock=parse_clock(clock_text, node=name),
        reference_broadcast=reference_broadcast,
        talk=lambda line: talk(f"{name}: {line}"),
    )
    run_until_stopped(_serve(node, parents, as_json))


async def _serve(node: "RelayNode", parents: tuple[Address, ...], as_json: bool) -> None:
    import asyncio

    async with node:
        talk(f"relay at {node.address}, below {', or '.join(map(str, parents))}")
        talk(f"join with: capture-app node --leader {node.address} --camera SPEC")
        if node.also:
            talk(f"or at {', '.join(map(str, node.also))}, whichever the nodes can reach")
        if as_json:
            address = {"relay": str(node.address), "port": node.address.port}
            print_json_line({"event": "listening", "name": node.name, **address})
        await asyncio.Event().wait()
