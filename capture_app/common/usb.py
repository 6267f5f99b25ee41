"""Which cameras share a USB bus, and how fast that is."""

from dataclasses import dataclass
from pathlib import Path

VIDEO_DEVICES = Path("/sys/class/video4linux")
USB2_MBIT_S = 480


@dataclass(frozen=True, slots=True)
class UsbCamera:
    """A camera on a USB bus."""

    node: str
    """Such as /dev/video0."""
    bus: int
    speed_mbit_s: int
    """That it has come to with its bus."""


def usb_cameras(devices: Path = VIDEO_DEVICES) -> list[UsbCamera]:
    """Return the USB cameras of this machine, each once, by their nodes."""
    found: dict[Path, UsbCamera] = {}
    for entry in sorted(devices.glob("video*"), key=lambda path: (len(path.name), path.name)):
        interface = (entry / "device").resolve()
        # A camera has several nodes; its first one gives the pictures.
        device = next((path for path in (interface, *interface.parents) if (path / "busnum").is_file()), None)
        if device is None or device in found:
            continue
        try:
            bus, speed = int((device / "busnum").read_text()), float((device / "speed").read_text())
        except (OSError, ValueError):
            continue
        found[device] = UsbCamera(f"/dev/{entry.name}", bus, round(speed))
    return list(found.values())


def crowded_buses(cameras: list[UsbCamera]) -> list[list[UsbCamera]]:
    """Return those of several cameras on one USB 2 bus, whose uncompressed pictures it cannot carry."""
    slow = [camera for camera in cameras if camera.speed_mbit_s <= USB2_MBIT_S]
    by_bus = ([camera for camera in slow if camera.bus == bus] for bus in sorted({c.bus for c in slow}))
    return [sharing for sharing in by_bus if len(sharing) > 1]
