"""`capture-app sessions repair`: finish what a crash, a power cut or a full disk interrupted."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from capture_app.commands.options import AddressType
from capture_app.errors import BadInputError
from capture_app.net.address import DEFAULT_PORT, Address
from capture_app.terminal import json_option, print_json, print_line, talk

if TYPE_CHECKING:
    from capture_app.node.leader.repair import Repaired

WAIT_S = 20.0


@click.command()
@click.argument("path", metavar="SESSION|ROOT", type=click.Path(path_type=Path))
@click.option(
    "--wait",
    "wait_s",
    type=click.FloatRange(min=0),
    default=WAIT_S,
    show_default=True,
    metavar="SECONDS",
    help="How long nodes have to come and bring what they still hold; 0 asks nobody.",
)
@click.option(
    "--listen",
    type=AddressType(),
    default=str(Address("0.0.0.0", DEFAULT_PORT)),  # noqa: S104 - nodes are other machines
    show_default=True,
    metavar="HOST:PORT",
    help="Where the nodes look for their leader.",
)
@json_option
def repair(path: Path, wait_s: float, listen: Address, as_json: bool) -> None:
    """Finish interrupted sessions: fetch what nodes hold, keep what is safe, mark what is lost as lost.

    Images that were saved are never changed; those that are damaged are moved to the session's set_aside.
    """
    import asyncio

    from capture_app.node.leader.repair import repair as repair_sessions
    from capture_app.node.leader.wording import News, in_words

    def on_news(news: News) -> None:
        if line := in_words(news):
            talk(line)

    repaired = asyncio.run(
        repair_sessions(path, wait_s=wait_s, host=listen.host, port=listen.port, on_news=on_news)
    )
    if as_json:
        print_json({"ok": all(one.ok for one in repaired), "sessions": repaired})
    else:
        for one in repaired:
            print_line(_line(one))
    failed = [one for one in repaired if not one.ok]
    if failed:
        raise BadInputError(f"{failed[0].session}: {failed[0].what}")


def _line(one: "Repaired") -> str:
    if not one.ok:
        return f"{one.session}: {one.what}"
    state = "finished" if one.changed else "whole"
    lost = f", {one.missing} are missing ({one.what})" if one.missing else ""
    return f"{one.session}: {state}, {one.images} images are safe{lost}"
