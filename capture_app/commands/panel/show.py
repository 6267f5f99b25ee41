"""`capture-app panel show`."""

import asyncio
import sys
import threading
from pathlib import Path

import click

from capture_app.commands.options import run_until_stopped
from capture_app.errors import SimulshotError
from capture_app.panel.screen.server import DEFAULT_PORT, PageServer
from capture_app.terminal import json_option, print_json, print_line, talk
from capture_app.usage import examples


@click.command(epilog=examples("capture-app panel show", "capture-app panel show --host 0.0.0.0"))
@click.option(
    "--host",
    default="127.0.0.1",
    help="Address that the page listens on; 0.0.0.0 shows it to phones of the network.",
)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=DEFAULT_PORT,
    metavar="PORT",
    help="TCP port of the page; 0 chooses a free one.",
)
@click.option(
    "--save",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Write the page to FILE (.html) instead, to open on a screen without a network.",
)
@json_option
def show(host: str, port: int, save: Path | None, as_json: bool) -> None:
    """Show a time code on a screen: a page for any browser, until Ctrl-C.

    Open it on one screen that all cameras see, in full screen. It measures the screen's refresh rate, numbers
    the refreshes and draws each one's number. With --host 0.0.0.0 a phone can show it: scan the code.
    """
    from capture_app.panel.screen.page import page_headers, page_html

    if save is not None:
        _save(save, page_html(), as_json)
        return
    with PageServer(host, port, page_html(), page_headers()) as server:
        run_until_stopped(_serve(server, as_json))


def _save(file: Path, page: bytes, as_json: bool) -> None:
    if file.suffix.lower() not in (".html", ".htm"):
        raise click.BadParameter(f"{file} does not end in .html", param_hint="--save")
    try:
        file.write_bytes(page)
    except OSError as error:
        raise SimulshotError(f"cannot write {file}: {error.strerror or error}") from error
    if as_json:
        print_json({"file": str(file)})
    else:
        print_line(str(file))


async def _serve(server: PageServer, as_json: bool) -> None:
    from capture_app.net.address import ANY_HOST, Address, reachable_host

    host, port = server.server_name, server.server_port
    outside = host in ANY_HOST
    url = f"http://{Address(reachable_host(host, server.socket.family), port)}/"
    if as_json:
        print_json({"url": url})
    else:
        print_line(url)
    if outside and sys.stderr.isatty():
        import segno

        segno.make(url, micro=False).terminal(sys.stderr, compact=True)
    who = "every machine of the network" if outside else "this machine only (--host 0.0.0.0: phones too)"
    talk(f"the page is for {who}; Ctrl-C ends it")
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        await asyncio.Event().wait()
    finally:
        server.shutdown()
