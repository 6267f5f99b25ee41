"""`capture-app burst`: take a burst with a running leader and wait for its session."""

import asyncio
import re
from pathlib import Path
from typing import TYPE_CHECKING

import click
from msgspec.structs import asdict

from capture_app.commands.options import leader_option
from capture_app.errors import IncompleteError, NetworkError, NoCameraHereError, SimulshotError
from capture_app.net.address import Address
from capture_app.terminal import FiniteRange, json_option, print_json, print_line, talk

if TYPE_CHECKING:
    from capture_app.node.wire.messages import BurstRequest
    from capture_app.node.wire.status import BurstStatus
    from capture_app.session.reading.verdict import Verdict

_FIGURE = re.compile(r"\d[\d.]* (ns|µs|ms|s)\b|--tolerance-us \d+")


@click.command()
@leader_option
@click.option(
    "--frames",
    type=click.IntRange(1, 1000),
    metavar="N",
    default=5,
    help="Number of frames from each camera.",
)
@click.option(
    "--spacing", type=click.IntRange(1, 10_000), metavar="N", default=1, help="Take every Nth frame."
)
@click.option(
    "--at-ns",
    type=int,
    metavar="NS",
    show_default="now",
    help="Time of the first frame by the leader's clock; may be in the recent past.",
)
@click.option(
    "--wait-s",
    type=FiniteRange(0.0, 3600.0),
    default=0.0,
    metavar="S",
    help="Wait up to this long until all nodes are ready.",
)
@click.option(
    "--min-nodes",
    type=click.IntRange(1),
    metavar="N",
    default=1,
    help="With --wait-s: wait until at least this many nodes are ready.",
)
@json_option
def burst(
    leader: Address,
    frames: int,
    spacing: int,
    at_ns: int | None,
    wait_s: float,
    min_nodes: int,
    as_json: bool,
) -> None:
    """Take a burst and print the path of its session, which is on the leader's machine."""
    from capture_app.node.wire.messages import BurstRequest

    request = BurstRequest(
        frames=frames, spacing=spacing, at_leader_ns=at_ns, wait_ready_s=wait_s, nodes=min_nodes
    )
    done = asyncio.run(_take_burst(leader, request))
    verdict = _judge_if_here(done)
    if as_json:
        print_json({**asdict(done), "verdict": verdict})
    elif done.session is not None:
        print_line(done.session)
        if verdict is not None:
            talk(f"{verdict.headline}; spread {verdict.spread}")
    if done.session is None or done.received < done.expected:
        raise IncompleteError(f"burst {done.burst} is incomplete: {done.message}")


def _judge_if_here(done: "BurstStatus") -> "Verdict | None":
    """The verdict where the session is on this machine: a leader elsewhere saves it there."""
    from capture_app.session.reading.reader import Session
    from capture_app.session.reading.verdict import judge

    try:
        return None if done.session is None else judge(Session.open(Path(done.session)).manifest)
    except SimulshotError:
        return None


async def _take_burst(leader: Address, request: "BurstRequest") -> "BurstStatus":
    from capture_app.node.leader.wording import burst_line
    from capture_app.node.operator.requests import ask_burst

    last, said = None, ""
    try:
        async for last in ask_burst(leader, request):
            line = burst_line(last)
            # A figure that changes a little while the rig is waited for is no news.
            gist = line if last.burst else _FIGURE.sub("", line)
            if gist != said:
                said = gist
                talk(line)
    except NoCameraHereError as error:
        hint = f"start one with: capture-app node --leader {leader} --camera SPEC"
        raise NoCameraHereError(error.what, hint=hint) from error
    if last is None:
        raise NetworkError(f"the leader at {leader} did not take the burst")
    return last
