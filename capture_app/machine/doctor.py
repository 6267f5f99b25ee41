"""Diagnosis of this machine: its clock, disks and cameras, the paths to leaders, and remedies."""

import asyncio
import os
import platform
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Literal

from msgspec import Struct

from capture_app import __version__
from capture_app.common import system
from capture_app.common.address import Address
from capture_app.common.camera_facts import CameraListing
from capture_app.common.errors import DiskError, SimulshotError
from capture_app.common.grouping import grouped
from capture_app.common.host_clock import RAW_CLOCK
from capture_app.common.text import count, megabytes
from capture_app.machine.cameras import list_cameras
from capture_app.net.discovery import LeaderBrowser, announced_hosts
from capture_app.net.local_network import (
    MDNS_PORT,
    Firewall,
    active_firewalls,
    power_saving,
    saves_power,
    wifi_interfaces,
)
from capture_app.net.reachability import find_obstacle
from capture_app.node.camera.spool import REPORT, unknown_in
from capture_app.protocol.pairing_messages import FoundLeader
from capture_app.rig.rig_link import ask_status
from capture_app.session.files.abilities import missing_abilities
from capture_app.session.files.disk import disk_error, free_bytes
from capture_app.sync.wire.codec import VERSION
from capture_app.trust.trust import Trust

Grade = Literal["good", "note", "warning", "problem"]
"""A problem prevents this machine from taking part; a warning degrades it or makes it less reliable."""
SAMPLE_BYTES = 16 << 20
USB_2_MBIT_S = 480
MAX_SHOWN = 5
"""Maximum number of a spool's bursts that are listed."""
SLOW_MB_S = 20.0
"""A slower disk delays bursts: a camera of 1080p at 30 frames/s produces about 15 MB/s of JPEG."""


def usb_cameras(devices: Path = Path("/sys/class/video4linux")) -> list[tuple[str, int, int]]:
    """Return device node, USB bus and speed (Mbit/s) of each USB camera here, in the order of the nodes."""
    disks: dict[Path, tuple[str, int, int]] = {}
    for entry in sorted(devices.glob("video*"), key=lambda path: (len(path.name), path.name)):
        interface = (entry / "device").resolve()
        # A camera has several device nodes; the first one delivers the images.
        device = next((path for path in (interface, *interface.parents) if (path / "busnum").is_file()), None)
        if device is not None and device not in disks:
            with suppress(OSError, ValueError):
                bus, speed = int((device / "busnum").read_text()), float((device / "speed").read_text())
                disks[device] = f"/dev/{entry.name}", bus, round(speed)
    return list(disks.values())


class Finding(Struct, frozen=True):
    """Result of one check; `remedy` is the command that fixes it, or says what to do."""

    check: str
    grade: Grade
    text: str
    remedy: str = ""


def version() -> Finding:
    """Report the software, protocol and platform versions."""
    return Finding(
        "version",
        "good",
        f"simulshot {__version__}, version {VERSION} of the protocol,"
        f" Python {platform.python_version()}, {platform.system()} on {platform.machine()}",
    )


def clock() -> Finding:
    """Report whether this host has a clock that no NTP daemon slews."""
    # Nothing slews the counter of Windows either.
    if RAW_CLOCK is not None or sys.platform == "win32":
        return Finding("clock", "good", "frames are timed by a clock that no NTP daemon slews")
    return Finding(
        "clock",
        "note",
        "an NTP daemon may slew the clock of this system; a rig notices it within seconds",
    )


def disk(
    folder: Path, holds: str, option: str, sample_bytes: int = SAMPLE_BYTES, slow_mb_s: float = SLOW_MB_S
) -> Finding:
    """Test a folder by writing to it; `holds` names its contents, `option` selects another folder."""
    other = f"choose another folder with {option}"
    try:
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        mb_s, free, lacks = _write_speed(folder, sample_bytes), free_bytes(folder), missing_abilities(folder)
    except (OSError, DiskError) as error:
        # Of the folder, not of the file that was to try it.
        failure = error if isinstance(error, DiskError) else disk_error(OSError(*error.args), folder)
        return Finding("disk", "problem", f"{holds}: {failure.what}", other)
    remedy = f"free some space, or {other}" if free < (1 << 30) else ""
    if mb_s < slow_mb_s:
        remedy = remedy or f"{other} on a faster disk"
    what = f"{holds}: {mb_s:.0f} MB/s to {folder}, {megabytes(free)} free"
    if lacks:
        what, remedy = f"{what}; {'; '.join(lacks)}", remedy or f"go on, or {other}"
    return Finding("disk", "warning" if remedy else "good", what, remedy)


def spooled(spool: Path) -> Iterator[Finding]:
    """Report the bursts that nodes of this machine keep until a leader takes them, and foreign files."""
    with suppress(OSError):
        spools = sorted((*spool.glob("[!.]*/"), *spool.glob(".[0-9]*/*/")))
        unknown = [path for folder in spools for path in unknown_in(folder)]
        if unknown:
            yield Finding(
                "spool",
                "note",
                f"{count(len(unknown), 'file')} that no node of this version wrote, which nodes leave alone:"
                f" {_first_of(unknown)}",
                "if a newer simulshot wrote them, update this one; otherwise move them elsewhere",
            )
        folders = sorted(report.parent for report in spool.glob(f"*/*/{REPORT}"))
        size = sum(file.stat().st_size for folder in folders for file in folder.iterdir())
        if folders:
            yield Finding(
                "spool",
                "note",
                f"{count(len(folders), 'burst')}, {megabytes(size)}, not taken by a leader yet:"
                f" {_first_of(folders)}",
                "run their cameras' nodes and their leader, or delete these folders to drop the images",
            )


def _first_of(paths: Sequence[Path]) -> str:
    return ", ".join([*map(str, paths[:MAX_SHOWN]), *(["..."] if len(paths) > MAX_SHOWN else [])])


def cameras(found: Sequence[CameraListing]) -> Iterator[Finding]:
    """Report which cameras are here, and why unusable ones are unusable."""
    real = [listing for listing in found if not listing.spec.startswith("sim:")]
    if not real:
        yield Finding(
            "cameras", "note", "no camera is connected to this machine", "list them with: capture-app cameras"
        )
    for listing in real:
        if listing.usable:
            yield Finding("cameras", "good", f"{listing.spec}: {listing.model or 'a camera'}")
        else:
            what, _, hint = listing.detail.partition(" (")
            yield Finding("cameras", "problem", what, hint.removesuffix(")"))


def usb(found: list[tuple[str, int, int]]) -> Iterator[Finding]:
    """Report cameras that share a USB 2 bus, which is too slow for their uncompressed images.

    `found`: device node, bus and speed (Mbit/s) of each camera, as `usb_cameras` returns them.
    """
    slow = grouped((bus, (node, mbit_s)) for node, bus, mbit_s in found if mbit_s <= USB_2_MBIT_S)
    crowded = [sharing for _, sharing in sorted(slow.items()) if len(sharing) > 1]
    for sharing in crowded:
        yield Finding(
            "usb",
            "warning",
            f"{' and '.join(node for node, _ in sharing)} share one USB 2 bus of {sharing[0][1]} Mbit/s",
            "add format=MJPG to their specs, or plug one into another controller's port",
        )
    if found and not crowded:
        yield Finding("usb", "good", f"{count(len(found), 'camera')}, none on a USB 2 bus with another")


def _write_speed(folder: Path, size: int) -> float:
    """Return the write speed of a folder's disk, including the sync, in MB/s."""
    data = os.urandom(1 << 20)
    with tempfile.TemporaryFile(dir=folder) as file:
        began_s = system.monotonic_s()
        for _ in range(size // len(data)):
            file.write(data)
        file.flush()
        system.sync_data(file.fileno())
        return size / 1e6 / max(system.monotonic_s() - began_s, 1e-9)


async def leader(address: Address) -> Finding:
    """Test the connection to a leader."""
    began_s = system.monotonic_s()
    if (obstacle := await find_obstacle(address)) is not None:
        return Finding("leader", "problem", obstacle.what, obstacle.remedy)
    return Finding(
        "leader",
        "good",
        f"the leader at {address} answers within {(system.monotonic_s() - began_s) * 1e3:.0f} ms",
    )


async def own_rig(address: Address) -> Finding:
    """Report the addresses at which other machines reach a rig of this machine."""
    try:
        status = await ask_status(address)
    except SimulshotError as error:
        return Finding("rig", "problem", error.what, error.hint)
    nodes = count(len(status.nodes), "node")
    if status.leader.startswith(("127.", "localhost", "[::1]")):
        return Finding(
            "rig",
            "warning",
            f"a rig with {nodes} runs here; only this machine can reach it, at {status.leader}",
            "start it without --host 127.0.0.1 for cameras of other machines",
        )
    where = " or ".join(
        str(Address(host, address.port)) for host in announced_hosts("") or [status.leader.rpartition(":")[0]]
    )
    return Finding("rig", "good", f"a rig with {nodes} runs here; others join it at {where}")


async def announced_leaders(listen_s: float = 1.5) -> list[Finding]:
    """Report the leaders announced on this network, whether they answer, and their version."""
    async with LeaderBrowser() as browser:
        await browser.refresh()
        await asyncio.sleep(listen_s)
        leaders = browser.found
    if not leaders:
        return [
            Finding(
                "discovery",
                "note",
                "no leader is announced on this network",
                "start one with: capture-app; for one beyond multicast give --leader HOST:PORT",
            )
        ]
    return list(await asyncio.gather(*map(_announced_leader, leaders)))


async def _announced_leader(found: FoundLeader) -> Finding:
    kind = "relay" if found.is_relay else "leader"
    obstacles = await asyncio.gather(*map(find_obstacle, found.addresses))
    reached = [address for address, obstacle in zip(found.addresses, obstacles, strict=True) if not obstacle]
    if not reached:
        what, remedy = next(
            ((obstacle.what, obstacle.remedy) for obstacle in obstacles if obstacle),
            ("it has no address", ""),
        )
        text = f"{kind} {found.name} is announced but not reachable: {what}"
        return Finding("discovery", "warning", text, remedy)
    text = f"{kind} {found.name} is announced and answers at {reached[0]}"
    if found.version != __version__:
        what = f"{text}; it runs simulshot {found.version}, this machine {__version__}"
        return Finding("discovery", "warning", what, "install the same version on both")
    return Finding("discovery", "good", text)


def warnings_for_leader(host: str, port: int, sessions: Path, root: Path = Path("/")) -> list[str]:
    """Return warnings about this machine as a leader's: of its sessions' disk, and what hinders cameras.

    Nothing of the network for a leader that only this machine can reach. `root` is the root of the
    machine's files.
    """
    # A short sample says whether it can be written, not how fast.
    checks = [disk(sessions, "sessions", "--sessions", 1 << 20, slow_mb_s=0.0)]
    if announced_hosts(host):
        checks += firewalls(active_firewalls(root), [port])
        checks += wifi(wifi_interfaces(root / "sys/class/net"))
    return [
        f"{finding.text}: {finding.remedy}" for finding in checks if finding.grade in ("warning", "problem")
    ]


def firewalls(active: Sequence[Firewall], ports: Sequence[int]) -> Iterator[Finding]:
    """Report firewalls of this machine that may block connections; cameras connect to `ports`."""
    for firewall in active:
        for port in ports:
            if not (opened := firewall.opens(port)):
                text = f"{firewall.name} is active here, and must allow incoming cameras on port {port}"
                unseen = " (only an administrator sees whether it does)" if opened is None else ""
                yield Finding("firewall", "warning", text + unseen, firewall.opening.format(port=port))
        if not firewall.opens(MDNS_PORT) and firewall.name != "ufw":
            # By default, ufw admits mDNS.
            text = f"{firewall.name} is active here: leaders are discovered only if it allows mDNS"
            yield Finding("firewall", "note", text, firewall.opening_udp.format(port=MDNS_PORT))
    if not active:
        is_known = sys.platform == "linux"
        text = "no firewall is enabled here, according to its files"
        yield Finding(
            "firewall",
            "good" if is_known else "note",
            text if is_known else "whether a firewall is enabled here is not known",
        )


def trust(own: Trust) -> Finding:
    """Report this machine's identity, and the number of machines that it knows."""
    if own.is_open:
        return Finding("trust", "note", "pairing is skipped: any machine is accepted")
    try:
        text = f"this machine's pin is {own.identity.pin}; it knows {count(len(own.known.all()), 'machine')}"
    except SimulshotError as error:
        return Finding("trust", "problem", error.what, error.hint)
    return Finding("trust", "good", text)


def wifi(interfaces: Sequence[str]) -> Iterator[Finding]:
    """Report WiFi interfaces that save power."""
    for interface in interfaces:
        match saves_power(interface):
            case True:
                yield Finding("wifi", "warning", *power_saving(interface))
            case False:
                yield Finding("wifi", "good", f"the WiFi of this machine ({interface}) saves no power")
            case None:
                yield Finding(
                    "wifi", "note", f"the driver of {interface} does not report whether it saves power"
                )


async def examine(
    leaders: Sequence[Address], own_rigs: Sequence[tuple[Address, Path]], spool: Path
) -> list[Finding]:
    """Run all checks on this machine, within seconds.

    `leaders` are those to reach, `own_rigs` run here and save to their folders; `spool` is where its nodes
    store their images.
    """
    sessions = dict.fromkeys((folder, "sessions", "--sessions") for _, folder in own_rigs)
    announced, rigs, paths = await asyncio.gather(
        announced_leaders(),
        asyncio.gather(*(own_rig(address) for address, _ in own_rigs)),
        asyncio.gather(*map(leader, leaders)),
    )
    written = await asyncio.gather(
        *(asyncio.to_thread(disk, *folder) for folder in ((spool, "the spool", "--spool"), *sessions))
    )
    return [
        version(),
        trust(Trust.of_user()),
        *rigs,
        *paths,
        *announced,
        *firewalls(active_firewalls(), sorted({address.port for address, _ in own_rigs})),
        *wifi(wifi_interfaces()),
        clock(),
        *written,
        *await asyncio.to_thread(lambda: [*spooled(spool)]),
        *cameras(await asyncio.to_thread(list_cameras)),
        *usb(usb_cameras()),
    ]
