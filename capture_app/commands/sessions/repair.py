"""`capture-app sessions repair`: complete sessions after a crash, a power cut or a full disk."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

import click

from capture_app.commands.options import ANY_PATH, AddressType
from capture_app.errors import BadInputError
from capture_app.net.address import DEFAULT_PORT, Address
from capture_app.session.files.output_folder import clear_leftovers
from capture_app.terminal import FiniteRange, json_option, print_json, print_line, talk
from capture_app.text import count
from capture_app.usage import examples

if TYPE_CHECKING:
    from capture_app.node.leader.repair import RepairResult

WAIT_S = 20.0


@click.command(
    epilog=examples(
        "capture-app sessions repair sessions/burst-001", "capture-app sessions repair sessions --wait-s 0"
    )
)
@click.argument("path", metavar="SESSION|ROOT", type=ANY_PATH)
@click.option(
    "--wait-s",
    type=FiniteRange(min=0),
    default=WAIT_S,
    metavar="S",
    help="Time for nodes to connect and send the images they still have; 0 does not wait for nodes.",
)
@click.option(
    "--listen",
    type=AddressType(),
    default=str(Address("0.0.0.0", DEFAULT_PORT)),  # noqa: S104 - nodes are other machines
    metavar="HOST:PORT",
    help="Address to listen on: the one that the nodes know as their leader's.",
)
@json_option
def repair(path: Path, wait_s: float, listen: Address, as_json: bool) -> None:
    """Complete interrupted sessions: fetch images that nodes still have and record which are lost.

    Saved images are never changed; damaged ones are moved to the folder set_aside of the session. What a
    killed import or rendering left in ROOT is removed; an earlier session that it had set aside is restored.
    """
    from capture_app.node.leader.repair import repair as repair_sessions
    from capture_app.node.leader.wording import News, news_line

    def on_news(news: News) -> None:
        if line := news_line(news):
            talk(line)

    clear_leftovers(path)
    repaired = asyncio.run(
        repair_sessions(path, wait_s=wait_s, host=listen.host, port=listen.port, on_news=on_news)
    )
    if as_json:
        print_json({"ok": all(one.ok for one in repaired), "sessions": repaired})
    else:
        for one in repaired:
            print_line(_describe_result(one))
    failed = [one for one in repaired if not one.ok]
    if failed:
        raise BadInputError(f"{failed[0].session}: {failed[0].what}")


def _describe_result(one: "RepairResult") -> str:
    if not one.ok:
        return f"{one.session}: {one.what}"
    state = "completed" if one.changed else "complete already"
    lost = f", {one.missing} missing ({one.what})" if one.missing else ""
    return f"{one.session}: {state}, {count(one.images, 'image')} saved{lost}"
