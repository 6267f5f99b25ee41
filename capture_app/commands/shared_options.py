"""Options that several commands share, and running a command until it is stopped."""

import asyncio
import contextlib
import functools
import os
import socket
import sys
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, TypeVar

import click
from platformdirs import user_state_path

from capture_app.common import system
from capture_app.common.address import DEFAULT_PORT, Address, parse_address
from capture_app.common.errors import ExitCode, NotAvailableError
from capture_app.common.names import check_name, name_like
from capture_app.common.plugins import load_plugins
from capture_app.common.stagger import Stagger
from capture_app.console.output import wait_for_no_reader
from capture_app.console.terminal import ParsedType

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")
ANY_PATH = click.Path(path_type=Path)
FOLDER = click.Path(path_type=Path, file_okay=False)
SAME_SIGNAL_S = 3.0
"""Time within which further requests to end a process count as the first one, in seconds.

A service manager signals a process and its parent, which passes that on.
"""
PHONES = "phones"
"""Command that a leader runs to accept phones as cameras."""
FOLLOWERS = "simulshot.followers"
"""Group of entry points: other programs that follow a rig, see `capture_app.node.followers`."""


ADDRESS = ParsedType("host:port", parse_address)


def together(*options: Callable[[Any], Any]) -> Callable[[F], F]:
    """Combine options into one decorator; the help lists them in this order."""
    return lambda command: functools.reduce(lambda made, option: option(made), reversed(options), command)


def _skip_pairing(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    if value:
        from capture_app.rig.membership import accept_any_machine

        ctx.with_resource(accept_any_machine())


open_option = click.option(
    "--open",
    is_flag=True,
    expose_value=False,
    is_eager=True,
    callback=_skip_pairing,
    help="Skip pairing and accept any machine. Use only on a trusted network, and on every machine; other "
    "commands do so where SIMULSHOT_OPEN=1 is set.",
)


def _default_leader() -> str:
    from capture_app.rig.process import list_rigs

    rigs = list_rigs()
    return rigs[0].leader if rigs else str(Address("127.0.0.1", DEFAULT_PORT))


leader_option = click.option(
    "--leader",
    type=ADDRESS,
    default=_default_leader,
    show_default=f"this machine's newest rig, else 127.0.0.1:{DEFAULT_PORT}",
    metavar="HOST:PORT",
    help="Address of the leader or a relay.",
)
leaders_option = click.option(
    "--leader",
    "leaders",
    type=ADDRESS,
    multiple=True,
    show_default="this machine's newest rig, else the one found in the network",
    metavar="HOST:PORT",
    help="Address of the leader or a relay. Repeat for failover, preferred first.",
)


def name_option(text: str, check: Callable[..., str] = check_name) -> Callable[[F], F]:
    """Make the option --name of a node or a relay; `text` is its help."""
    return click.option(
        "--name",
        type=ParsedType("text", functools.partial(check, what="node")),
        default=lambda: name_like(socket.gethostname().split(".")[0], "node"),
        show_default="the host name",
        help=text,
    )


spool_option = click.option(
    "--spool",
    type=FOLDER,
    default=lambda: user_state_path("simulshot") / "spool",
    metavar="DIR",
    show_default="~/.local/state/simulshot/spool",
    help="Spool: folder on this machine that stores images until the leader has saved them.",
)
host_option = click.option(
    "--host",
    default="0.0.0.0",  # noqa: S104 - cameras are other machines
    help="Address to listen on; 127.0.0.1 accepts this machine only.",
)
port_option = click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=DEFAULT_PORT,
    metavar="PORT",
    help="UDP and TCP port; 0 chooses a free one.",
)
rig_port_option = click.option(
    "--port",
    type=click.IntRange(1, 65535),
    metavar="PORT",
    show_default=f"{DEFAULT_PORT}, or a free one",
    help="UDP and TCP port of the rig.",
)
stagger_option = click.option(
    "--stagger",
    type=ParsedType("text", Stagger.parse),
    metavar="ORDER",
    show_default="all at one instant",
    help="Take frames one after the other, for film and fast things: even, or delays cam0=0ms,cam1=8.3ms.",
)
cameras_option = click.option(
    "--camera", "cameras", multiple=True, metavar="SPEC", help="Run a camera of this machine. Repeatable."
)
sessions_option = click.option(
    "--sessions", type=FOLDER, default=Path("sessions"), metavar="DIR", help="Folder for the sessions."
)
attached_sessions_option = click.option(
    "--sessions",
    type=FOLDER,
    metavar="DIR",
    show_default="the running rig's, else sessions",
    help="Folder for the sessions.",
)
clock_option = click.option(
    "--clock",
    "clock_text",
    default="host",
    metavar="CLOCK",
    help="host, or sim[:offset_s=…,skew_ppm=…] for a simulated clock that is hours off.",
)


def page_options(default_port: int) -> Callable[[F], F]:
    """Make the options --host, --port and --certificate of a page for phones."""
    return together(
        click.option(
            "--host",
            default="0.0.0.0",  # noqa: S104 - phones are other machines
            help="Address that the page listens on.",
        ),
        click.option(
            "--port",
            type=click.IntRange(0, 65535),
            show_default=f"{default_port}, or a free one",
            metavar="PORT",
            help="TCP port of the page; 0 chooses a free one.",
        ),
        click.option(
            "--certificate",
            type=click.Path(path_type=Path, dir_okay=False, exists=True),
            metavar="FILE",
            show_default="a self-signed one, about which browsers warn once",
            help="PEM file with a certificate for this machine's name, and its key.",
        ),
    )


def plugin_options(group: str) -> Callable[[F], F]:
    """Combine the `OPTIONS` of a group's plugins."""
    plugins = load_plugins(group, "OPTIONS").values()
    return together(*(option for plugin in plugins for option in plugin.OPTIONS))


def confirm(question: str, refusal: str) -> None:
    """Ask at the terminal, and end the command without a yes. Raises NotAvailableError without a terminal."""
    if not sys.stdin.isatty():
        raise NotAvailableError(refusal, hint="confirm with --yes")
    click.confirm(question, abort=True, err=True)


def restrict_file_access() -> None:
    """Create files for owner and group only from now on, to hide pictures from other users."""
    with contextlib.suppress(ValueError):
        os.umask(int(os.environ.get("SIMULSHOT_UMASK", "027"), 8))


def run_until_stopped(work: Coroutine[Any, Any, T], *, until_eof: bool = False) -> T:
    """Run a coroutine until it is done, or until SIGINT, SIGTERM or SIGHUP; return its result.

    The work may still save something then; a later request ends the process at once. Its output never waits
    for the reader. `until_eof`: stop also when stdin, a pipe, closes, because the parent process has ended.
    """

    running: list[asyncio.Future[T]] = []

    async def stoppable() -> T:
        task, loop = asyncio.ensure_future(work), asyncio.get_running_loop()
        running.append(task)
        asked_s: list[float] = []

        def end(data: bytes = b"") -> None:
            if data or (asked_s and loop.time() - asked_s[0] <= SAME_SIGNAL_S):
                return
            if asked_s:
                os._exit(ExitCode.INTERRUPTED)
            asked_s.append(loop.time())
            task.cancel()

        system.on_end(end)
        if until_eof:
            system.watch_input(end)
        return await task

    wait_for_no_reader()
    restrict_file_access()
    try:
        with asyncio.Runner(loop_factory=system.new_event_loop) as runner:
            try:
                return runner.run(stoppable())
            except KeyboardInterrupt:
                if not all(task.done() for task in running):  # Ctrl-C again
                    os._exit(ExitCode.INTERRUPTED)
                raise
    except asyncio.CancelledError:
        raise KeyboardInterrupt from None
