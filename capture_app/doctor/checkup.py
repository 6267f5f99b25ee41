"""All looks at a machine, in the order in which they matter."""

import asyncio
from collections.abc import Sequence
from pathlib import Path

from capture_app.cameras.catalog import list_cameras
from capture_app.cameras.v4l2.usb import usb_cameras
from capture_app.doctor import host, network
from capture_app.doctor.finding import Finding
from capture_app.host_rate import HostRate
from capture_app.net.address import Address
from capture_app.net.firewall import active_firewalls
from capture_app.net.wifi import wifi_interfaces
from capture_app.trust.trust import Trust


async def examine(
    leaders: Sequence[Address], own_rigs: Sequence[tuple[Address, Path]], spool: Path
) -> list[Finding]:
    """Look this machine over, within seconds.

    `leaders` are those that it is to reach, `own_rigs` run on it and save to their folders; `spool` is where
    its nodes keep their images.
    """
    folders = dict.fromkeys(folder for _, folder in own_rigs)
    disks = [(spool, "the spool", "--spool"), *((folder, "sessions", "--sessions") for folder in folders)]
    clock, announced, rigs, ways = await asyncio.gather(
        host.clock(HostRate()),
        network.announced_leaders(),
        asyncio.gather(*(network.own_rig(address) for address, _ in own_rigs)),
        asyncio.gather(*map(network.leader, leaders)),
    )
    # After the clock: a busy disk would hold its readings up.
    written = await asyncio.gather(*(asyncio.to_thread(host.disk, *disk) for disk in disks))
    return [
        host.version(),
        network.trust(Trust.of_user()),
        *rigs,
        *ways,
        *announced,
        *network.firewalls(active_firewalls(), sorted({address.port for address, _ in own_rigs})),
        *network.wifi(wifi_interfaces()),
        clock,
        *written,
        *host.cameras(await asyncio.to_thread(list_cameras)),
        *host.usb(usb_cameras()),
    ]
