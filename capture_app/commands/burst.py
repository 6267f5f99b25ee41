"""`capture-app burst`: make a running leader take a burst, and wait for its session."""

import asyncio
from typing import TYPE_CHECKING

import click

from capture_app.commands.options import leader_option
from capture_app.net.address import Address
from capture_app.terminal import json_option, print_json, print_line, talk

if TYPE_CHECKING:
    from capture_app.node.wire.messages import BurstRequest
    from capture_app.node.wire.status import BurstStatus


@click.command()
@leader_option
@click.option(
    "--frames", type=click.IntRange(1, 1000), default=5, show_default=True, help="Instants in the burst."
)
@click.option(
    "--spacing",
    type=click.IntRange(1, 10_000),
    default=1,
    show_default=True,
    help="Frame periods from one instant to the next.",
)
@click.option(
    "--at-ns", type=int, help="First instant in ns of the leader's clock, past or future; default: at once."
)
@click.option(
    "--wait-ready",
    type=click.FloatRange(0.0, 3600.0),
    default=0.0,
    show_default=True,
    metavar="SECONDS",
    help="Wait up to this long for all nodes to be ready.",
)
@click.option(
    "--nodes",
    type=click.IntRange(1),
    default=1,
    show_default=True,
    help="With --wait-ready: the fewest nodes that must be ready.",
)
@json_option
def burst(
    leader: Address,
    frames: int,
    spacing: int,
    at_ns: int | None,
    wait_ready: float,
    nodes: int,
    as_json: bool,
) -> None:
    """Take a burst and print the path of its session (on the leader's machine)."""
    from capture_app.errors import IncompleteError
    from capture_app.node.wire.messages import BurstRequest

    request = BurstRequest(
        frames=frames, spacing=spacing, at_leader_ns=at_ns, wait_ready_s=wait_ready, nodes=nodes
    )
    done = asyncio.run(_take(leader, request))
    if as_json:
        print_json(done)
    elif done.session is not None:
        print_line(done.session)
    if done.session is None or done.received < done.expected:
        raise IncompleteError(f"burst {done.burst} is incomplete: {done.message}")


async def _take(leader: Address, request: "BurstRequest") -> "BurstStatus":
    from capture_app.errors import NetworkError, NoCameraHereError
    from capture_app.node.leader.control import ask_burst
    from capture_app.node.leader.wording import burst_in_words

    last, said = None, ""
    try:
        async for last in ask_burst(leader, request):
            line = burst_in_words(last)
            if line != said:
                said = line
                talk(line)
    except NoCameraHereError as error:
        hint = f"start one with: capture-app node --leader {leader} --camera SPEC"
        raise NoCameraHereError(error.what, hint=hint) from error
    if last is None:
        raise NetworkError(f"the leader at {leader} took no burst")
    return last
