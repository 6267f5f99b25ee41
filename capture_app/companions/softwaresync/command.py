"""`capture-app softwaresync`: lead phones with the paper's Android app, on a rig's time."""

import asyncio
import random
from contextlib import ExitStack, suppress

import click

from capture_app.commands.shared_options import host_option, leader_option, run_until_stopped
from capture_app.common.address import Address
from capture_app.common.errors import NetworkError
from capture_app.common.host_clock import host_from_monotonic, host_ns
from capture_app.common.tasks import first_of
from capture_app.common.text import Talk
from capture_app.companions.softwaresync.app_leader import CALL_PORT, REQUEST, TIME_PORT, AppLeader
from capture_app.console.terminal import log_line, talk
from capture_app.console.usage import examples
from capture_app.protocol.status import RigStatus
from capture_app.rig.rig_link import RigLink, ask_status
from capture_app.rig.rig_time import rig_time
from capture_app.sync.clock.clock_filter import ClockSample

ASK_EVERY_S, SEND_EVERY_S, NEW_PHONE = 0.02, 1.0, 0.2
"""Intervals of clock requests to each phone and of offsets; and the share of the requests that a phone gets
which has not answered yet: forged heartbeats aim no flood at anyone."""


@click.command(
    short_help="Lead phones with the paper's Android app of 2019.",
    epilog=examples("capture-app softwaresync", "capture-app softwaresync --leader 192.168.1.20"),
)
@leader_option
@host_option
def softwaresync(leader: Address, host: str) -> None:
    """Lead phones with the app libsoftwaresync: each saves a frame of every burst. Runs until Ctrl-C.

    The app takes its WiFi's hotspot for the leader, so run this there. It cannot pair, and its frames stay on
    the phone, from where `capture-app sessions import` reads them.
    """
    talk(
        f"ANDROID APP: phones with libsoftwaresync join by UDP {CALL_PORT} and {TIME_PORT}. There is no"
        " pairing: anyone in that network can control these phones. The errors of their sensors are unknown"
    )
    run_until_stopped(lead_phones(leader, host, log_line))


async def lead_phones(leader: Address, host: str, say: Talk) -> None:
    """Lead the app's phones that reach `host`, on the time of the rig at `leader`, until cancelled.

    `say` gets a line about each change. Raises NetworkError where the app's ports are in use, or the leader
    does not answer at first, and UnknownMachineError.
    """
    await ask_status(leader)
    app, loop = AppLeader(say), asyncio.get_running_loop()
    with ExitStack() as ports:
        for port in (TIME_PORT, CALL_PORT):
            try:
                transport, _ = await loop.create_datagram_endpoint(lambda: app, (host, port))
            except OSError as error:
                raise NetworkError(
                    f"cannot listen on {Address(host, port)}: {error.strerror or error}",
                    hint="the app knows no other port: end the other program that uses it",
                ) from error
            ports.callback(transport.close)
            app.send = transport.sendto
        await first_of(_watch(leader, app), _send_times(leader, app), _ask(app))


async def _watch(leader: Address, app: AppLeader) -> None:
    async for update in RigLink(leader).updates():
        if isinstance(update, RigStatus):
            app.see_rig(update)


async def _send_times(leader: Address, app: AppLeader) -> None:
    while True:
        with suppress(NetworkError):
            now = await rig_time(leader)
            t3_ns = host_from_monotonic(now.local_ns)
            # The rig's time is as wide as one exchange with an immediate answer.
            t0_ns = t3_ns - (now.latest_ns - now.earliest_ns)
            app.rig_clock.add(ClockSample(t0_ns, now.earliest_ns, now.earliest_ns, t3_ns))
        app.send_time()
        await asyncio.sleep(SEND_EVERY_S)


async def _ask(app: AppLeader) -> None:
    while True:
        for host in [
            h for h, phone in app.phones.items() if phone.clock.samples or random.random() < NEW_PHONE
        ]:
            app.send(REQUEST.pack(host_ns()), (host, TIME_PORT))
        await asyncio.sleep(ASK_EVERY_S)
