"""Options and output that several commands share."""

import asyncio
import contextlib
import os
import signal
import sys
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

import click
from platformdirs import user_state_path

from capture_app.net.address import DEFAULT_PORT, Address, parse_address


class AddressType(click.ParamType[Address]):
    """An option that is HOST:PORT."""

    name = "host:port"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Address:
        """Read the text; a mistake is a usage error."""
        if isinstance(value, Address):
            return value
        try:
            return parse_address(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)


leader_option = click.option(
    "--leader",
    type=AddressType(),
    default=str(Address("127.0.0.1", DEFAULT_PORT)),
    show_default=True,
    metavar="HOST:PORT",
    help="Where the leader listens.",
)

leaders_option = click.option(
    "--leader",
    "leaders",
    type=AddressType(),
    multiple=True,
    default=(str(Address("127.0.0.1", DEFAULT_PORT)),),
    show_default=True,
    metavar="HOST:PORT",
    help="Where the leader, or a relay, listens; again for others to ask when it is gone, the best first.",
)


spool_option = click.option(
    "--spool",
    type=click.Path(path_type=Path, file_okay=False),
    default=lambda: user_state_path("simulshot") / "spool",
    metavar="DIR",
    help="Folder on this machine's disk that keeps bursts until the leader has them.  [default: "
    "~/.local/state/simulshot/spool]",
)
host_option = click.option(
    "--host",
    default="0.0.0.0",  # noqa: S104 - cameras are other machines
    show_default=True,
    help="Address to listen on; 127.0.0.1 for this machine only.",
)
port_option = click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=DEFAULT_PORT,
    show_default=True,
    help="Port for UDP and TCP; 0 takes a free one.",
)
clock_option = click.option(
    "--clock",
    "clock_text",
    default="host",
    show_default=True,
    metavar="CLOCK",
    help="host, or sim[:offset_s=…,skew_ppm=…] for a clock that is hours off.",
)
beacons_option = click.option(
    "--reference-broadcast/--no-reference-broadcast",
    default=False,
    show_default=True,
    help="Send multicast beacons: nodes alike that hear one access point agree better with each other.",
)


def run_until_stopped(work: Coroutine[Any, Any, None], *, until_eof: bool = False) -> None:
    """Run until it is done, or until SIGINT or SIGTERM, after which everything is put away in order.

    `until_eof` stops it also when stdin, a pipe, closes: whoever started this process has ended.
    """

    async def stoppable() -> None:
        task = asyncio.ensure_future(work)
        loop = asyncio.get_running_loop()
        with contextlib.suppress(NotImplementedError):
            loop.add_signal_handler(signal.SIGTERM, task.cancel)
        if until_eof:
            loop.add_reader(sys.stdin.fileno(), _stop_at_eof, loop, task)
        await task

    try:
        asyncio.run(stoppable())
    except asyncio.CancelledError:
        raise KeyboardInterrupt from None


def _stop_at_eof(loop: asyncio.AbstractEventLoop, task: "asyncio.Future[None]") -> None:
    if not os.read(sys.stdin.fileno(), 4096):
        loop.remove_reader(sys.stdin.fileno())
        task.cancel()
