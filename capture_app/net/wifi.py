"""WiFi power saving: an interface that sleeps between beacons, so that messages wait until it wakes."""

import contextlib
import fcntl
import socket
import struct
import subprocess
from pathlib import Path

from capture_app.common.address import interface_of, source_address

NETWORKS = Path("/sys/class/net")
_SIOCGIWPOWER = 0x8B2D
_REQUEST = struct.Struct("@16siBBH8x")
"""`struct iwreq` with its `struct iw_param` (<linux/wireless.h>)."""
_IW_TIMEOUT_S = 2.0


def wifi_interfaces(networks: Path = NETWORKS) -> list[str]:
    """Return the names of this machine's WiFi interfaces."""
    try:
        found = [folder.name for folder in networks.iterdir() if (folder / "phy80211").exists()]
    except OSError:
        return []
    return sorted(found)


def saves_power(interface: str) -> bool | None:
    """Whether a WiFi interface saves power; None if its driver does not report it."""
    request = _REQUEST.pack(interface.encode()[:15], 0, 0, 0, 0)
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        _, _, _, disabled, _ = _REQUEST.unpack(fcntl.ioctl(probe, _SIOCGIWPOWER, request))
        return not disabled
    # Drivers without the old interface answer only to `iw`.
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        output = subprocess.run(  # noqa: S603 - the name of an interface of this machine
            ["iw", "dev", interface, "get", "power_save"],  # noqa: S607 - wherever it is installed
            capture_output=True,
            text=True,
            timeout=_IW_TIMEOUT_S,
            check=True,
        ).stdout
        return parse_power_save(output)
    return None


def parse_power_save(output: str) -> bool | None:
    """Parse the output of `iw dev DEVICE get power_save`."""
    _, _, state = output.strip().lower().rpartition(" ")
    return {"on": True, "off": False}.get(state)


def power_saving_towards(host: str, networks: Path = NETWORKS) -> str:
    """Return the WiFi interface towards a host if it saves power, else an empty string."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    source = source_address(host, family)
    interface = None if source is None else interface_of(source)
    if interface is None or interface not in wifi_interfaces(networks):
        return ""
    return interface if saves_power(interface) else ""


def power_saving(interface: str) -> str:
    """Return the message that an interface saves power."""
    return f"the WiFi of this machine ({interface}) saves power, which delays messages by up to 0.1 s"


def power_saving_remedy(interface: str) -> str:
    """Return the command that disables power saving until the next boot."""
    return f"sudo iw dev {interface} set power_save off"
