"""`capture-app status`: the nodes of a running leader."""

import asyncio
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import click
from msgspec import to_builtins

from capture_app.commands.shared_options import leader_option, run_until_stopped
from capture_app.common.address import Address
from capture_app.common.text import clock_offset, count
from capture_app.console.terminal import answer, json_option, print_json_line, print_line, table, talk
from capture_app.console.usage import examples

if TYPE_CHECKING:
    from capture_app.protocol.status import NodeStatus, RigStatus

NO_TIME = "-"
_STAMPS = "stamps µs"


@click.command(epilog=examples("capture-app status", "capture-app status --leader 192.168.1.20 --watch"))
@leader_option
@click.option("--watch", is_flag=True, help="Then show changes until Ctrl-C.")
@json_option
def status(leader: Address, watch: bool, as_json: bool) -> None:
    """Show the nodes of a running leader and its relays: state, clock, phase, drops.

    "clock bound" is the maximum clock error, including the relays'. "phase error" is the time from the common
    frame grid to the camera's frames. "stamps" is the 95 % uncertainty of the camera's timestamp delay.

    With --watch each event follows in a line; with --json as an object, with a new status after each change,
    at most ten a second.
    """
    from capture_app.rig.rig_link import ask_status

    rig = asyncio.run(ask_status(leader))
    if as_json and watch:
        print_json_line({"event": "status", "rig": rig})
    else:
        answer(as_json, rig, _lines(rig))
    if watch:
        run_until_stopped(_watch(leader, rig, as_json))


async def _watch(leader: Address, rig: "RigStatus", as_json: bool) -> None:
    from capture_app.protocol.status import LogLine, RigStatus
    from capture_app.rig.rig_link import LinkLost, RigLink

    began_ns, advice = time.time_ns(), rig.advice
    async for update in RigLink(leader).updates():
        match update:
            case RigStatus():
                if as_json:
                    print_json_line({"event": "status", "rig": update})
                elif update.advice != advice:
                    print_line(f"{_clock_time(time.time_ns())} {update.advice}")
                advice = update.advice
            # A new connection first receives older events.
            case LogLine() if update.unix_ns >= began_ns:
                if as_json:
                    print_json_line({"event": "log", **to_builtins(update)})
                else:
                    print_line(f"{_clock_time(update.unix_ns)} {update.text}")
            case LinkLost():
                if as_json:
                    print_json_line({"event": "link-lost", "reason": update.reason})
                else:
                    talk(update.reason)


def _clock_time(unix_ns: int) -> str:
    return f"{datetime.fromtimestamp(unix_ns / 1e9, UTC).astimezone():%H:%M:%S}"


def _lines(rig: "RigStatus") -> Iterator[str]:
    from capture_app.protocol.status import in_tree_order

    who = f"leader {rig.leader}" if rig.relay is None else f"relay {rig.relay} at {rig.leader}"
    rate = "no frame rate yet" if rig.period_ns is None else f"{1e9 / rig.period_ns:.3f} frames/s"
    yield f"{who}, {count(len(rig.nodes), 'node')}, {rate}"
    if rig.order:
        yield rig.order
    if rig.is_open:
        yield "OPEN: the rig accepts any machine without pairing"
    yield from filter(None, dict.fromkeys((rig.message, rig.advice)))
    if rig.nodes:
        rows = [_node_row(node) for node in in_tree_order(rig.nodes)]
        # Hide columns that are empty for every node.
        shown = [
            heading
            for heading in rows[0]
            if heading != _STAMPS or any(row[heading] != NO_TIME for row in rows)
        ]
        yield table(shown, [[row[name] for name in shown] for row in rows])
    for ahead in rig.ahead:
        begins = clock_offset(max(0, ahead.first_leader_ns - rig.now_ns), signed=False)
        burst = f"burst {ahead.burst} ({ahead.name}) begins in {begins}"
        yield f"{burst}; cancel it: capture-app burst --cancel {ahead.burst}"
    yield from (f"saved {path}" for path in rig.sessions)


def _node_row(node: "NodeStatus") -> dict[str, str]:
    return {
        "node": "  " * (node.depth - 1) + node.camera.called(node.name),
        "state": node.state.with_error(node.time_error_ns),
        "clock bound µs": _microseconds(node.hard_bound_ns),
        _STAMPS: _microseconds(_stamp_error_ns(node)),
        "round trip µs": _microseconds(node.round_trip_ns),
        "phase error µs": _microseconds(node.phase_error_ns),
        "drops": str(node.drops),
        "camera": node.camera.model,
        "message": node.message,
    }


def _stamp_error_ns(node: "NodeStatus") -> int | None:
    """Return the uncertainty of a node's timestamp delay; None if exact, or without a camera."""
    from capture_app.common.node_state import WITHOUT_CAMERA

    stamp = node.camera.stamp_accuracy
    return None if node.camera.kind in WITHOUT_CAMERA or stamp.is_exact else stamp.uncertainty_ns


def _microseconds(time_ns: int | None) -> str:
    return NO_TIME if time_ns is None else f"{time_ns / 1000:.1f}"
