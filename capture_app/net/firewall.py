"""Firewalls of this machine, as far as any user can see them, and the command that opens a port."""

import re
from dataclasses import dataclass
from pathlib import Path

MDNS_PORT = 5353
_UFW_ENABLED = re.compile(r"^\s*ENABLED\s*=\s*yes\b", re.IGNORECASE | re.MULTILINE)

_DENIES = re.compile(r"\b(deny|drop|reject)\b", re.IGNORECASE)
_COMMENT = re.compile(r"^\s*#(?!## tuple ).*$", re.MULTILINE)
"""Comments of nftables and ufw, except ufw's "### tuple" lines, which state what its other lines do."""
_RULE = re.compile(r"<rule\b.*?</rule>|(?:(?!<rule\b)[^;\n])+", re.DOTALL)
"""A rich rule of firewalld, which may span several lines, or one line or statement of any other firewall."""


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
    """Return the firewalls that are enabled at boot, by their files below `root`."""
    found = []
    if _UFW_ENABLED.search(_read(root / "etc/ufw/ufw.conf") or ""):
        rules = _read(root / "etc/ufw/user.rules")
        found.append(Firewall("ufw", "sudo ufw allow {port}", "sudo ufw allow {port}/udp", rules))
    if (root / "run/firewalld").is_dir():
        zones = [_read(path) for path in sorted((root / "etc/firewalld/zones").glob("*.xml"))]
        rules = "\n".join(zone for zone in zones if zone is not None) if None not in zones else None
        udp, tcp = "--add-port={port}/udp", "--add-port={port}/tcp"
        change = "sudo firewall-cmd --permanent {} && sudo firewall-cmd --reload"
        both, udp = change.replace("{}", f"{udp} {tcp}"), change.replace("{}", udp)
        found.append(Firewall("firewalld", both, udp, rules))
    if (root / "etc/systemd/system/sysinit.target.wants/nftables.service").is_symlink():
        rules = _read(root / "etc/nftables.conf")
        # The default file drops nothing. An additional table cannot open what another one drops.
        if rules is None or _DENIES.search(rules):
            line = "add a rule for port {port} to /etc/nftables.conf, then: sudo systemctl reload nftables"
            found.append(Firewall("nftables", line, line, rules))
    return found


def _read(path: Path) -> str | None:
    try:
        return path.read_text(errors="replace")
    except OSError:
        return None
