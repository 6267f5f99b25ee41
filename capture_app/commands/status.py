"""`capture-app status`: the nodes of a running leader."""

import asyncio
from typing import TYPE_CHECKING

import click

from capture_app.commands.options import leader_option
from capture_app.net.address import Address
from capture_app.terminal import json_option, print_json, print_line, print_table
from capture_app.text import count

if TYPE_CHECKING:
    from capture_app.node.wire.status import NodeStatus


@click.command()
@leader_option
@json_option
def status(leader: Address, as_json: bool) -> None:
    """Show the nodes of a running leader, those of its relays included: state, clock, phase, drops.

    "clock bound" is the largest possible clock error, that of the relays included. "apart", with reference
    broadcast, is the uncertainty (95 %) between nodes that receive the same beacons.
    """
    from capture_app.node.operator.requests import ask_status

    rig = asyncio.run(ask_status(leader))
    if as_json:
        print_json(rig)
        return
    from capture_app.node.leader.snapshots import in_tree_order

    who = f"leader {rig.leader}" if rig.relay is None else f"relay {rig.relay} at {rig.leader}"
    rate = "no frame rate yet" if rig.period_ns is None else f"{1e9 / rig.period_ns:.3f} frames/s"
    print_line(f"{who}, {count(len(rig.nodes), 'node')}, {rate}")
    for line in dict.fromkeys((rig.message, rig.advice)):
        if line:
            print_line(line)
    if rig.nodes:
        rows = [_node_row(node) for node in in_tree_order(rig.nodes)]
        if all(node.relative_uncertainty_ns is None for node in rig.nodes):
            for row in rows:
                del row["apart µs"]
        print_table(tuple(rows[0]), [tuple(row.values()) for row in rows])
    for path in rig.sessions:
        print_line(f"saved {path}")


def _node_row(node: "NodeStatus") -> dict[str, str]:
    return {
        "node": "  " * (node.depth - 1) + node.name,
        "state": str(node.state),
        "clock bound µs": _microseconds(node.hard_bound_ns),
        "apart µs": _microseconds(node.relative_uncertainty_ns),
        "round trip µs": _microseconds(node.round_trip_ns),
        "phase error µs": _microseconds(node.phase_error_ns),
        "drops": str(node.drops),
        "camera": node.camera.model,
        "message": node.message,
    }


def _microseconds(time_ns: int | None) -> str:
    return "-" if time_ns is None else f"{time_ns / 1000:.1f}"
