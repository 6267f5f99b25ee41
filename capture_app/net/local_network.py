"""Settings of this machine that hinder messages: firewalls that block them, and WiFi that saves power.

Firewalls are seen as far as any user can see them, with the command that opens a port. A WiFi interface that
saves power sleeps between beacons, so that messages wait until it wakes.
"""

import contextlib
import os
import re
import socket
import subprocess
from dataclasses import dataclass
from pathlib import Path

from capture_app.common import system
from capture_app.common.address import interface_of, source_address

MDNS_PORT = 5353
_UFW_ENABLED = re.compile(r"^\s*ENABLED\s*=\s*yes\b", re.IGNORECASE | re.MULTILINE)

_DENIES = re.compile(r"\b(deny|drop|reject)\b", re.IGNORECASE)
_COMMENT = re.compile(r"^\s*#(?!## tuple ).*$", re.MULTILINE)
"""Comments of nftables and ufw, except ufw's "### tuple" lines, which state what its other lines do."""
_RULE = re.compile(r"<rule\b.*?</rule>|(?:(?!<rule\b)[^;\n])+", re.DOTALL)
"""A rich rule of firewalld, which may span several lines, or one line or statement of any other firewall."""

NETWORKS = Path("/sys/class/net")
_IW_TIMEOUT_S = 2.0


@dataclass(frozen=True, slots=True)
class Firewall:
    """An active firewall of this machine: its name, its rules, and the command that opens a port."""

    name: str
    opening: str
    """Command that opens a port for UDP and TCP; contains a {port}."""
    opening_udp: str
    """Command that opens the port for UDP alone."""
    rules: str | None = None
    """Its rules; None if this user may not read them."""

    def opens(self, port: int) -> bool | None:
        """Whether the first rule that names the port admits it; None if the rules cannot be read."""
        if self.rules is None:
            return None
        # firewalld applies its rich rules before the plain list of open ports, wherever they stand.
        rules = sorted(_RULE.findall(_COMMENT.sub("", self.rules)), key=lambda rule: "<rule" not in rule)
        first = next((rule for rule in rules if re.search(rf"\b{port}\b", rule)), None)
        return first is not None and _DENIES.search(first) is None


def active_firewalls(root: Path = Path("/")) -> list[Firewall]:
    """Return the firewalls that are enabled at boot, by their files below `root`; Windows' own always is."""
    if os.name == "nt":
        rule = "netsh advfirewall firewall add rule name=simulshot dir=in action=allow program="
        opening = f'as administrator: {rule}"{system.PYTHON[0]}"'
        return [Firewall("Windows Defender Firewall", opening, opening)]
    addresses = []
    if _UFW_ENABLED.search(_read(root / "etc/ufw/ufw.conf") or ""):
        addresses.append(
            Firewall(
                "ufw",
                "sudo ufw allow {port}",
                "sudo ufw allow {port}/udp",
                _read(root / "etc/ufw/user.rules"),
            )
        )
    if (root / "run/firewalld").is_dir():
        zones = [_read(path) for path in sorted((root / "etc/firewalld/zones").glob("*.xml"))]
        rules = "\n".join(zone for zone in zones if zone is not None) if None not in zones else None
        change = "sudo firewall-cmd --permanent --add-port={{port}}/udp{} && sudo firewall-cmd --reload"
        both, udp = change.format(" --add-port={port}/tcp"), change.format("")
        addresses.append(Firewall("firewalld", both, udp, rules))
    if (root / "etc/systemd/system/sysinit.target.wants/nftables.service").is_symlink():
        rules = _read(root / "etc/nftables.conf")
        # The default file drops nothing. An additional table cannot open what another one drops.
        if rules is None or _DENIES.search(rules):
            line = "add a rule for port {port} to /etc/nftables.conf, then: sudo systemctl reload nftables"
            addresses.append(Firewall("nftables", line, line, rules))
    return addresses


def _read(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None


def wifi_interfaces(networks: Path = NETWORKS) -> list[str]:
    """Return the names of this machine's WiFi interfaces."""
    with contextlib.suppress(OSError):
        return sorted(folder.name for folder in networks.iterdir() if (folder / "phy80211").exists())
    return []


def saves_power(interface: str) -> bool | None:
    """Whether a WiFi interface saves power; None if its driver does not report it."""
    if (answered := system.saves_power(interface)) is not None:
        return answered
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
    return {"on": True, "off": False}.get(output.strip().lower().rpartition(" ")[2])


def power_saving_towards(host: str) -> str:
    """Return the WiFi interface towards a host if it saves power, else an empty string."""
    source = source_address(host, socket.AF_INET6 if ":" in host else socket.AF_INET)
    interface = (None if source is None else interface_of(source)) or ""
    return interface if interface in wifi_interfaces() and saves_power(interface) else ""


def power_saving(interface: str) -> tuple[str, str]:
    """Return the message that an interface saves power, and the command that ends it until the next boot."""
    return (
        f"the WiFi of this machine ({interface}) saves power, which delays messages by up to 0.1 s",
        f"sudo iw dev {interface} set power_save off",
    )
