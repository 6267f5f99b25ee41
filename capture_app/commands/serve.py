"""`capture-app serve`: the terminal UI in a browser."""

import asyncio
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from capture_app.commands.shared_options import ADDRESS, attached_sessions_option, run_until_stopped
from capture_app.common.address import LOOPBACK_HOSTS, Address, listen_tcp, reachable_host
from capture_app.common.text import command_line
from capture_app.console.terminal import answer, json_option, talk
from capture_app.console.usage import examples

if TYPE_CHECKING:
    from capture_app.rig.process import AttachedRig

_REFUSAL = (
    "The screen is for its own page only: open it by this machine's address or host name, "
    "or start it with capture-app serve --allow-host NAME.\n"
)


@click.command(epilog=examples("capture-app serve", "capture-app serve --port 8080 --leader 192.168.1.20"))
@click.option("--host", default="127.0.0.1", help="Address that the page listens on; 0.0.0.0: all networks.")
@click.option(
    "--allow-host",
    "names",
    multiple=True,
    metavar="NAME",
    help="Accept this name of the machine in requests, too; default: its addresses and host name.",
)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=8000,
    metavar="PORT",
    help="TCP port of the page; 0 chooses a free one.",
)
@click.option(
    "--leader",
    type=ADDRESS,
    metavar="HOST:PORT",
    show_default="the running rig of this machine, else a new one",
    help="Address of the leader whose rig is shown.",
)
@attached_sessions_option
@json_option
def serve(
    host: str,
    names: tuple[str, ...],
    port: int,
    leader: Address | None,
    sessions: Path | None,
    as_json: bool,
) -> None:
    """Show the terminal UI in a browser, until Ctrl-C; the rig keeps running.

    There is no password: anyone who reaches the page controls the rig and sees the sessions. By default it
    listens on this machine only.
    """
    from capture_app.rig.process import attach

    rig = asyncio.run(attach(leader=leader, sessions=sessions))
    run_until_stopped(_serve(rig, host, (*names, host), port, as_json))


async def _serve(rig: "AttachedRig", host: str, names: tuple[str, ...], port: int, as_json: bool) -> None:
    from textual_serve.server import Server

    from capture_app.web.own_page import only_own_page, served

    screen = ("capture_app.cli", "--leader", str(rig.leader), "--sessions", str(rig.sessions))
    command = command_line(sys.executable, "-m", *screen)
    with listen_tcp(host, port) as listening:
        bound, port = listening.getsockname()[:2]
        url = f"http://{Address(reachable_host(bound, listening.family), port)}"
        # Its own way to serve prints a banner, and accepts requests from pages of other sites.
        app = await Server(command, bound, port, title="simulshot", public_url=url)._make_app()
        app.on_startup.clear()
        app.middlewares.append(only_own_page(names, _REFUSAL))
        async with served(app, listening):
            answer(as_json, {"url": url, "leader": str(rig.leader), "sessions": str(rig.sessions)}, [url])
            who = "any user of this machine" if host in LOOPBACK_HOSTS else "anyone in the network"
            talk(f"the page shows the rig {rig.leader}; {who} can control it; Ctrl-C stops the page")
            await asyncio.Event().wait()
