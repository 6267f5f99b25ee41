"""USB cameras of this machine, with the bus and its speed."""

from dataclasses import dataclass
from pathlib import Path

VIDEO_DEVICES = Path("/sys/class/video4linux")
USB2_MBIT_S = 480


@dataclass(frozen=True, slots=True)
class UsbCamera:
    """Camera on a USB bus."""

    node: str
    """Device node, such as /dev/video0."""
    bus: int
    speed_mbit_s: int
    """Negotiated speed of its bus."""


def usb_cameras(devices: Path = VIDEO_DEVICES) -> list[UsbCamera]:
    """Return the USB cameras of this machine, each once, in the order of their device nodes."""
    found: dict[Path, UsbCamera] = {}
    for entry in sorted(devices.glob("video*"), key=lambda path: (len(path.name), path.name)):
        interface = (entry / "device").resolve()
        # A camera has several device nodes; the first one delivers the images.
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
    """Return the cameras of each USB 2 bus with several: it is too slow for their uncompressed images."""
    slow = [camera for camera in cameras if camera.speed_mbit_s <= USB2_MBIT_S]
    by_bus = ([camera for camera in slow if camera.bus == bus] for bus in sorted({c.bus for c in slow}))
    return [sharing for sharing in by_bus if len(sharing) > 1]
