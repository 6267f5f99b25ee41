"""`capture-app mark`: note an event at the rig's time."""

import asyncio

import click

from capture_app.commands.shared_options import leader_option
from capture_app.common import system
from capture_app.common.address import Address
from capture_app.common.text import duration
from capture_app.console.terminal import answer, json_option
from capture_app.console.usage import examples


@click.command(
    short_help="Note an event at the rig's time in the take under way.",
    epilog=examples("capture-app mark stimulus", 'capture-app mark "door opens" --leader 192.168.1.20'),
)
@click.argument("text")
@leader_option
@json_option
def mark(text: str, leader: Address, as_json: bool) -> None:
    """Note an event at the rig's time in the session of the take under way.

    The mark has TEXT, the time at which the command began, and its error. Python reads it as
    open_session(...).marks. Without a take, it is stored in marks.ndjson in the rig's sessions folder. For
    events to the millisecond use rig.mark in Python, as a command takes a while to start.
    """
    called_ns = system.monotonic_ns()
    from capture_app.rig.rig_time import place_mark

    placed = asyncio.run(place_mark(leader, text, called_ns))
    where = ", ".join(placed.sessions) or f"{placed.file}: no take is under way"
    error = duration(placed.mark.uncertainty_ns)
    answer(as_json, placed, [f"{placed.mark.leader_ns} ns ±{error}"], said=f"stored in {where}")
