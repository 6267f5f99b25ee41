"""`capture-app status`: the rig of a running leader, once."""

import asyncio
from typing import TYPE_CHECKING

import click

from capture_app.commands.options import leader_option
from capture_app.net.address import Address
from capture_app.terminal import json_option, print_json, print_line, print_table

if TYPE_CHECKING:
    from capture_app.node.wire.status import NodeStatus


@click.command()
@leader_option
@json_option
def status(leader: Address, as_json: bool) -> None:
    """Show the nodes of a running leader, or of its whole tree: state, clock, phase and drops.

    A clock bound is all that the time can be wrong by, the relays on its way included. Nodes that hear the
    leader's beacons together also tell how far apart they may be: 95 % of the cases.
    """
    from capture_app.node.leader.control import ask_status

    rig = asyncio.run(ask_status(leader))
    if as_json:
        print_json(rig)
        return
    from capture_app.node.leader.snapshots import as_tree

    who = f"leader {rig.leader}" if rig.relay is None else f"relay {rig.relay} at {rig.leader}"
    print_line(f"{who}, {len(rig.nodes)} nodes, {_period(rig.period_ns)}")
    if rig.message:
        print_line(rig.message)
    if rig.nodes:
        agreed = any(node.apart_ns is not None for node in rig.nodes)
        clock = ("clock bound us", *(("apart us",) if agreed else ()), "round trip us")
        head = ("node", "state", *clock, "phase error us", "drops", "camera", "")
        print_table(head, [_row(node, agreed=agreed) for node in as_tree(rig.nodes)])
    for path in rig.sessions:
        print_line(f"saved {path}")


def _row(node: "NodeStatus", *, agreed: bool) -> tuple[str, ...]:
    return (
        "  " * (node.depth - 1) + node.name,
        str(node.state),
        _us(node.hard_bound_ns),
        *((_us(node.apart_ns),) if agreed else ()),
        _us(node.round_trip_ns),
        _us(node.phase_error_ns),
        str(node.drops),
        node.camera.model,
        node.message,
    )


def _us(time_ns: int | None) -> str:
    return "-" if time_ns is None else f"{time_ns / 1000:.1f}"


def _period(period_ns: int | None) -> str:
    return "no frame rate yet" if period_ns is None else f"{1e9 / period_ns:.3f} frames/s"
