"""This machine without its network: versions, clock, disks, cameras and who may use them."""

import asyncio
import os
import platform
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from capture_app import __version__
from capture_app.cameras.base import CameraListing
from capture_app.cameras.v4l2.usb import UsbCamera, crowded_buses
from capture_app.doctor.finding import Finding
from capture_app.errors import DiskError
from capture_app.host_rate import EVERY_NS, HostRate
from capture_app.session.files.disk import disk_error, free_bytes
from capture_app.sync.rig.node_message import slewing
from capture_app.sync.wire.version import VERSION
from capture_app.text import count, megabytes

SAMPLE_BYTES = 16 << 20
SLOW_MB_S = 20.0
"""A disk slower than this holds a burst up: a camera of 1080p at 30 frames/s makes about 15 MB/s of JPEG."""
LITTLE_BYTES = 1 << 30
CLOCK_WATCHED_S = 2.2


def version() -> Finding:
    """Say what runs here."""
    text = (
        f"simulshot {__version__}, version {VERSION} of the protocol,"
        f" Python {platform.python_version()}, {platform.system()} on {platform.machine()}"
    )
    return Finding(check="version", grade="good", text=text)


async def clock(rate: HostRate, watched_s: float = CLOCK_WATCHED_S) -> Finding:
    """Watch this host's clock for a while: an NTP daemon may be slewing it."""
    rate.slewing_ppm(0)
    await asyncio.sleep(watched_s)
    ppm = rate.slewing_ppm(EVERY_NS)
    if ppm is None:
        text = "this host does not say whether its clock is being corrected"
        return Finding(check="clock", grade="note", text=text)
    if ppm:
        what, _, remedy = slewing("this host", ppm).partition("; ")
        return Finding(check="clock", grade="warning", text=what, remedy=remedy)
    return Finding(check="clock", grade="good", text="this host's clock runs steadily")


def disk(folder: Path, holds: str, option: str, sample_bytes: int = SAMPLE_BYTES) -> Finding:
    """Write to a folder for a moment; it `holds` what is named, and `option` chooses another one."""
    other = f"choose another folder with {option}"
    try:
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        mb_s, free = _write_speed(folder, sample_bytes), free_bytes(folder)
    except OSError as error:
        told = disk_error(error, folder)
        return Finding(check="disk", grade="problem", text=f"{holds}: {told.what}", remedy=other)
    except DiskError as error:
        return Finding(check="disk", grade="problem", text=f"{holds}: {error.what}", remedy=other)
    what = f"{holds}: {mb_s:.0f} MB/s to {folder}, {megabytes(free)} free"
    if free < LITTLE_BYTES:
        return Finding(check="disk", grade="warning", text=what, remedy=f"make room, or {other}")
    if mb_s < SLOW_MB_S:
        return Finding(check="disk", grade="warning", text=what, remedy=f"{other} on a faster disk")
    return Finding(check="disk", grade="good", text=what)


def cameras(found: Sequence[CameraListing]) -> Iterator[Finding]:
    """Say which cameras are here, and why those that cannot be used cannot."""
    real = [listing for listing in found if not listing.spec.startswith("sim:")]
    if not real:
        text = "no camera is plugged into this machine"
        yield Finding(check="cameras", grade="note", text=text, remedy="capture-app cameras lists them")
    for listing in real:
        if listing.usable:
            text = f"{listing.spec}: {listing.model or 'a camera'}"
            yield Finding(check="cameras", grade="good", text=text)
        else:
            what, _, hint = listing.detail.partition(" (")
            yield Finding(check="cameras", grade="problem", text=what, remedy=hint.removesuffix(")"))


def usb(found: list[UsbCamera]) -> Iterator[Finding]:
    """Say which cameras share a bus that is too slow for them."""
    for sharing in crowded_buses(found):
        nodes = " and ".join(camera.node for camera in sharing)
        yield Finding(
            check="usb",
            grade="warning",
            text=f"{nodes} share one USB 2 bus of {sharing[0].speed_mbit_s} Mbit/s",
            remedy="add format=MJPG to their specs, or plug one into another controller's port",
        )
    if found and not crowded_buses(found):
        text = f"{count(len(found), 'camera')}, none on a USB 2 bus with another"
        yield Finding(check="usb", grade="good", text=text)


def _write_speed(folder: Path, size: int, clock: Callable[[], float] = time.monotonic) -> float:
    """Return how fast a folder's disk takes data in, synced, in MB/s."""
    data = os.urandom(1 << 20)
    with tempfile.TemporaryFile(dir=folder) as file:
        began_s = clock()
        for _ in range(size // len(data)):
            file.write(data)
        file.flush()
        os.fsync(file.fileno())
        return size / 1e6 / max(clock() - began_s, 1e-9)
