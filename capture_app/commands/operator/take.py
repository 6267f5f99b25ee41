"""What `burst` and `record` share: they wait for the rig, follow a take until it is saved, and judge it."""

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from msgspec.structs import asdict

from capture_app.errors import IncompleteError, NetworkError, NoCameraHereError, SimulshotError
from capture_app.net.address import Address
from capture_app.terminal import FiniteRange, print_line, talk

if TYPE_CHECKING:
    from capture_app.node.wire.messages import BurstRequest
    from capture_app.node.wire.status import BurstStatus
    from capture_app.session.reading.verdict import Verdict

F = TypeVar("F", bound=Callable[..., Any])
SAID_EVERY_S = 1.0
"""How far a take is that goes on for long is said no more often."""
_FIGURE = re.compile(r"\d[\d.]* (ns|µs|ms|s)\b|--tolerance-us \d+")

_wait_option = click.option(
    "--wait-s",
    type=FiniteRange(0.0, 3600.0),
    default=0.0,
    metavar="S",
    help="Wait up to this long until all nodes are ready.",
)
_nodes_option = click.option(
    "--min-nodes",
    type=click.IntRange(1),
    metavar="N",
    default=1,
    help="With --wait-s: wait until at least this many nodes are ready.",
)


def ready_options(command: F) -> F:
    """Give a command that takes something the options --wait-s and --min-nodes."""
    return _wait_option(_nodes_option(command))


async def take_burst(
    leader: Address, request: "BurstRequest", on_status: Callable[["BurstStatus"], None] = lambda _: None
) -> "BurstStatus":
    """Take a burst or a recording, tell on stderr how far it is, and return how it ended.

    Raises NetworkError, and the leader's own errors.
    """
    from capture_app.node.leader.wording import burst_line
    from capture_app.node.operator.requests import ask_burst

    last, said, counted_s = None, "", 0.0
    try:
        async for last in ask_burst(leader, request):
            on_status(last)
            line = burst_line(last)
            # A figure that changes a little while the rig is waited for is no news.
            gist = line if last.burst else _FIGURE.sub("", line)
            waits = last.burst and not last.done and time.monotonic() < counted_s + SAID_EVERY_S
            if gist != said and not waits:
                said, counted_s = gist, time.monotonic()
                talk(line)
    except NoCameraHereError as error:
        hint = f"start one with: capture-app node --leader {leader} --camera SPEC"
        raise NoCameraHereError(error.what, hint=hint) from error
    if last is None:
        raise NetworkError(f"the leader at {leader} did not take the burst")
    return last


def show_take(done: "BurstStatus", as_json: bool) -> dict[str, Any]:
    """Print the path of the session of a take that is over and how good it is, and return its JSON record.

    With `as_json` nothing is printed: that is left to the caller, who may have several.
    """
    verdict = _judge_if_here(done)
    if not as_json and done.session is not None:
        print_line(done.session)
        if verdict is not None:
            talk(f"{verdict.headline}; spread {verdict.spread}")
            if verdict.stamps:
                talk(verdict.stamps)
    return {**asdict(done), "verdict": verdict}


def require_whole(kind: str, done: "BurstStatus") -> None:
    """Raise IncompleteError where images of a take are missing, or there is no session.

    One without a number was taken by phones of their own app, which keep what they took.
    """
    if done.done and not done.burst:
        return
    if done.session is None or done.received < done.expected:
        raise IncompleteError(f"{kind} {done.burst} is incomplete: {done.message}")


def _judge_if_here(done: "BurstStatus") -> "Verdict | None":
    """The verdict where the session is on this machine: a leader elsewhere saves it there."""
    from capture_app.session.reading.reader import Session
    from capture_app.session.reading.verdict import judge

    try:
        return None if done.session is None else judge(Session.open(Path(done.session)).manifest)
    except SimulshotError:
        return None
