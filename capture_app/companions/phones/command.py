"""`capture-app phones`: a page that makes phones cameras of a rig, and the QR code that opens it."""

import asyncio
import re
from pathlib import Path

import click

from capture_app.commands.leader_choice import inviting_phones, leaders_to_join, pairing_options
from capture_app.commands.shared_options import (
    leaders_option,
    page_options,
    run_until_stopped,
    spool_option,
)
from capture_app.common import system
from capture_app.common.address import Address
from capture_app.console.terminal import ParsedType, json_option, log_line
from capture_app.console.usage import examples

DEFAULT_PORT = 47011


def _parse_size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{2,5})x(\d{2,5})", text)
    if match is None:
        raise ValueError(f"{text!r} is not WIDTHxHEIGHT")
    return int(match[1]), int(match[2])


@click.command(
    short_help="Use phones as cameras: they scan a QR code.",
    epilog=examples("capture-app phones", "capture-app phones --leader 192.168.1.20"),
)
@leaders_option
@page_options(DEFAULT_PORT)
@click.option(
    "--size",
    type=ParsedType("size", _parse_size),
    default="1280x720",
    metavar="WxH",
    help="Requested image size of the phones; a slow phone uses half.",
)
@click.option(
    "--sound", is_flag=True, help="Record the phones' microphones, too; each browser asks its user."
)
@spool_option
@pairing_options
@click.option("--until-eof", is_flag=True, hidden=True, help="Stop when stdin closes: the parent is gone.")
@json_option
def phones(
    leaders: tuple[Address, ...],
    host: str,
    port: int | None,
    size: tuple[int, int],
    certificate: Path | None,
    sound: bool,
    spool: Path,
    pin: str | None,
    code: str | None,
    until_eof: bool,
    as_json: bool,
) -> None:
    """Use phones as cameras: scan the QR code and allow the camera. Runs until Ctrl-C.

    A code admits one phone and expires after ten minutes; then the next one is shown. The phone's browser
    warns of an unknown certificate: its fingerprint is shown beside the code.
    """
    leaders = leaders_to_join(leaders, pin, code)
    run_until_stopped(
        _run(leaders, host, port, size, certificate, sound, spool, as_json), until_eof=until_eof
    )


async def _run(
    leaders: tuple[Address, ...],
    host: str,
    port: int | None,
    size: tuple[int, int],
    certificate: Path | None,
    sound: bool,
    spool: Path,
    as_json: bool,
) -> None:
    from capture_app.companions.phones.gateway import PhoneGateway
    from capture_app.companions.phones.phone_camera import PhoneNodes
    from capture_app.web.admission import Admission
    from capture_app.web.paired_page import ListeningPage

    admission = Admission(system.monotonic_s)
    page = ListeningPage(admission, host, port, DEFAULT_PORT, certificate)
    nodes = PhoneNodes(leaders, spool, log_line, sound=sound)
    gateway = PhoneGateway(admission, nodes.add, size, sound=sound)
    try:
        async with (
            gateway.serving(page.socket, page.tls, page.names),
            inviting_phones(page.invitation, as_json),
        ):
            await asyncio.Event().wait()
    finally:
        await nodes.close()
