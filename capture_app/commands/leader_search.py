"""Which leader a node joins that was told none: one of this machine or its network."""

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from capture_app.commands.options import run_until_stopped
from capture_app.errors import NetworkError
from capture_app.net.address import DEFAULT_PORT, Address
from capture_app.terminal import log_line, talk

if TYPE_CHECKING:
    from capture_app.net.discovery.search import ReachableLeader


def find_leader() -> Address:
    """Wait until a leader of this machine or its network answers; ask at the terminal which of several.

    Raises NetworkError where there are several and nobody to ask.
    """
    from capture_app.net.discovery.search import search_leaders
    from capture_app.rig_process import list_rigs

    def own() -> tuple[Address, ...]:
        return (*(rig.address for rig in list_rigs()), Address("127.0.0.1", DEFAULT_PORT))

    leader = choose_leader(run_until_stopped(search_leaders(own, log_line)), can_ask=sys.stdin.isatty())
    log_line(f"found a leader at {leader.address} ({leader.name})")
    return leader.address


def choose_leader(found: "Sequence[ReachableLeader]", *, can_ask: bool) -> "ReachableLeader":
    """Return the leader that was found; of several the one that the user names.

    Raises NetworkError where there are several and nobody to ask.
    """
    if len(found) == 1:
        return found[0]
    if not can_ask:
        names = ", ".join(f"{one.address} ({one.name})" for one in found)
        raise NetworkError(f"several leaders are in this network: {names}", hint="choose one by --leader")
    for number, one in enumerate(found, 1):
        talk(f"{number}  {one.address}  {one.name}{'' if one.is_known else '  (not paired)'}")
    which = click.IntRange(1, len(found))
    chosen: int = click.prompt("Several leaders are here. Which", type=which, default=1, err=True)
    return found[chosen - 1]
