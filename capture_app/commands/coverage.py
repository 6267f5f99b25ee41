"""`capture-app coverage`: coverage of the images by a calibration board in front of a running rig."""

import asyncio
import contextlib
import functools
import sys
from collections.abc import Callable
from contextlib import aclosing
from typing import TYPE_CHECKING

import click

from capture_app.board.boards import board_options
from capture_app.commands.shared_options import leader_option, run_until_stopped
from capture_app.common.address import Address
from capture_app.common.errors import IncompleteError
from capture_app.console.option_rules import Rule, RuledCommand
from capture_app.console.terminal import FiniteRange, json_option, print_json_line, print_line, talk
from capture_app.console.usage import examples

if TYPE_CHECKING:
    from rich.live import Live

    from capture_app.board.coverage import BoardCoverage
    from capture_app.board.detector import Board


@click.command(
    cls=RuledCommand,
    rules=(Rule("--marker-mm", "!--dictionary=none", ": it has no markers"),),
    epilog=examples("capture-app coverage", "capture-app coverage --square-mm 34.6 --leader 192.168.1.20"),
)
@board_options
@click.option(
    "--for-s",
    type=FiniteRange(1.0, 86_400.0),
    metavar="S",
    show_default="until the coverage is complete",
    help="Stop after this time even if views are missing.",
)
@leader_option
@json_option
def coverage(board: "Board", for_s: float | None, leader: Address, as_json: bool) -> None:
    """Show live which views of a calibration board the cameras have, and which are missing.

    Detects the board in the cameras' previews and saves nothing. To calibrate, also take a burst of the
    board, during the count or after it, and run `reconstruct calibrate`. Ends when the coverage is complete,
    or with Ctrl-C.
    """
    from rich.live import Live

    show = print_json_line if as_json else functools.partial(_draw, Live(auto_refresh=False))
    found = run_until_stopped(_count(leader, board, for_s, show))
    if found.missing:
        raise IncompleteError(
            f"the coverage is incomplete: {'; '.join(found.missing[:3])}",
            hint="show the board there, and run it again",
        )
    if not as_json:
        print_line("the coverage is complete: record half a minute in which the board moves like this")


async def _count(
    leader: Address,
    board: "Board",
    for_s: float | None,
    show: "Callable[[BoardCoverage], None]",
) -> "BoardCoverage":
    from capture_app.rig.board_coverage import watch_coverage
    from capture_app.rig.rig_link import RigLink, ask_status

    rig = await ask_status(leader)
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(for_s), aclosing(watch_coverage(RigLink(leader), rig, board)) as changes:
            async for found in changes:
                if isinstance(found, str):
                    talk(found)
                else:
                    shown = found
                    show(shown)
    return shown


def _draw(live: "Live", found: "BoardCoverage") -> None:
    """Redraw the table in place on a terminal; elsewhere print a line for each change."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    from capture_app.board.coverage import coverage_table

    if not sys.stdout.isatty():
        views = ", ".join(f"{name} {seen.views}" for name, seen in found.cameras.items())
        print_line(f"views: {views}; {(*found.missing, 'complete')[0]}")
        return
    head, rows = coverage_table(found)
    table = Table(*head)
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    if not live.is_started:
        live.start()
        click.get_current_context().call_on_close(live.stop)
    live.update(Group(table, *(Text(line) for line in found.missing[:4])), refresh=True)
