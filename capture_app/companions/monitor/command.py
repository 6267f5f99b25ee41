"""`capture-app monitor`: a page for the director's phone or tablet, and the QR code that opens it."""

import asyncio
from pathlib import Path

import click

from capture_app.commands.leader_choice import inviting_phones
from capture_app.commands.shared_options import leader_option, page_options, run_until_stopped
from capture_app.common import system
from capture_app.common.address import Address
from capture_app.companions.monitor import DEFAULT_PORT
from capture_app.console.terminal import json_option
from capture_app.console.usage import examples


@click.command(
    short_help="Show live pictures and the take button on phones and tablets.",
    epilog=examples("capture-app monitor", "capture-app monitor --leader 192.168.1.20"),
)
@leader_option
@page_options(DEFAULT_PORT)
@json_option
def monitor(leader: Address, host: str, port: int | None, certificate: Path | None, as_json: bool) -> None:
    """Serve a monitor for phones and tablets: live pictures, the take button, the last take. Until Ctrl-C.

    Scan the QR code to open it. Each code admits one device, which then may do what this machine may: see the
    rig and take pictures. Run it on the leader's machine, which has the pictures of the last take.
    """
    run_until_stopped(_run(leader, host, port, certificate, as_json))


async def _run(leader: Address, host: str, port: int | None, certificate: Path | None, as_json: bool) -> None:
    from capture_app.companions.monitor.monitor_page import serving_monitor
    from capture_app.rig.process import attach
    from capture_app.rig.rig_link import RigLink, ask_status
    from capture_app.web.admission import Admission
    from capture_app.web.paired_page import ListeningPage

    await ask_status(leader)
    rig = await attach(leader=leader)
    page = ListeningPage(Admission(system.monotonic_s, "monitor"), host, port, DEFAULT_PORT, certificate)
    async with (
        serving_monitor(RigLink(leader), page, is_local=rig.is_local),
        inviting_phones(page.invitation, as_json),
    ):
        await asyncio.Event().wait()
