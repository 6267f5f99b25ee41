"""`capture-app phones`: a page that makes phones cameras of a rig, and the QR code that opens it."""

import asyncio
import re
import socket
import time
from datetime import UTC, datetime
from pathlib import Path

import click

from capture_app.commands.joining import inviting_phones, leaders_to_join, pairing_options
from capture_app.commands.options import leaders_option, open_option, run_until_stopped, spool_option
from capture_app.common.address import ANY_HOST, Address, listen_tcp, reachable_host
from capture_app.console.terminal import ParsedType, json_option, log_line
from capture_app.console.usage import examples

DEFAULT_PORT = 47011


def _parse_size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{2,5})x(\d{2,5})", text)
    if found is None:
        raise ValueError(f"{text!r} is not WIDTHxHEIGHT")
    return int(found[1]), int(found[2])


@click.command(epilog=examples("capture-app phones", "capture-app phones --leader 192.168.1.20"))
@leaders_option
@click.option(
    "--host",
    default="0.0.0.0",  # noqa: S104 - phones are other machines
    help="Address that the page listens on.",
)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    show_default=f"{DEFAULT_PORT}, or a free one",
    metavar="PORT",
    help="TCP port of the page; 0 chooses a free one.",
)
@click.option(
    "--size",
    type=ParsedType("size", _parse_size),
    default="1280x720",
    metavar="WxH",
    help="Requested image size of the phones; a slow phone uses half.",
)
@click.option(
    "--certificate",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    metavar="FILE",
    show_default="a self-signed one, about which browsers warn once",
    help="PEM file with a certificate for this machine's name, and its key.",
)
@spool_option
@pairing_options
@open_option
@click.option("--until-eof", is_flag=True, hidden=True, help="Stop when stdin closes: the parent is gone.")
@json_option
def phones(
    leaders: tuple[Address, ...],
    host: str,
    port: int | None,
    size: tuple[int, int],
    certificate: Path | None,
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
    run_until_stopped(_run(leaders, host, port, size, certificate, spool, as_json), until_eof=until_eof)


async def _run(
    leaders: tuple[Address, ...],
    host: str,
    port: int | None,
    size: tuple[int, int],
    certificate_file: Path | None,
    spool: Path,
    as_json: bool,
) -> None:
    from platformdirs import user_data_path

    from capture_app.phones.camera import PhoneNodes
    from capture_app.phones.gateway import PhoneGateway
    from capture_app.protocol.orders import PhoneInvited
    from capture_app.web.admission import Admission
    from capture_app.web.certificate import load_certificate, own_certificate

    listening = listen_tcp(host, *((DEFAULT_PORT, 0) if port is None else (port,)))
    shown = reachable_host(host, listening.family) if host in ANY_HOST else host
    where = Address(shown, listening.getsockname()[1])
    if certificate_file is None:
        folder = user_data_path("simulshot", appauthor=False) / "trust"
        certificate = own_certificate(folder, (shown, socket.gethostname()), datetime.now(UTC))
    else:
        certificate = load_certificate(certificate_file)
    admission = Admission(time.monotonic)
    nodes = PhoneNodes(leaders, spool, log_line)
    gateway = PhoneGateway(admission, nodes.add, size)

    async def invitation() -> PhoneInvited:
        # Read the secret first: it may be a new one, whose validity starts then.
        url = f"https://{where}/#{admission.secret}"
        return PhoneInvited(url=url, fingerprint=certificate.fingerprint, good_for_s=admission.good_for_s)

    try:
        async with (
            gateway.serving(listening, certificate.server_context(), (host, *certificate.names())),
            inviting_phones(invitation, as_json),
        ):
            await asyncio.Event().wait()
    finally:
        await nodes.close()
