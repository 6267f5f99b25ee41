"""Two machines on one cable, as network namespaces of this one; each has a firewall of its own."""

import itertools
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

SEARCH_PATH = os.environ.get("PATH", os.defpath) + ":/usr/sbin:/sbin"
LEADER_HOST, NODE_HOST, NOBODY = "10.77.0.1", "10.77.0.2", "10.77.0.99"
_PAIRS = itertools.count()


class Machine:
    """One of them."""

    def __init__(self, name: str) -> None:
        self.name = name

    def command(self, *words: str) -> list[str]:
        """Return the command that runs another one there."""
        return [_tool("ip"), "netns", "exec", self.name, *words]

    def ip(self, *words: str) -> None:
        """Change its network, as the command `ip` does."""
        _ip("-n", self.name, *words)

    def start_python(self, *words: str, **environment: str) -> subprocess.Popen[str]:
        """Start a program of Python's there; both of its outputs are one."""
        return subprocess.Popen(
            self.command(sys.executable, *words),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1", **environment},
        )

    def add_firewall(self, hook: str, *rules: str) -> None:
        """Set rules of nftables for its `input` or `output`; skip the test without nftables."""
        if shutil.which("nft", path=SEARCH_PATH) is None:
            pytest.skip("no nftables here; apt-get install nftables")
        chain = f"type filter hook {hook} priority 0;"
        lines = "\n".join(rules)
        name = f"table inet simulshot_{hook}"
        table = f"{name} {{}}\ndelete {name}\n{name} {{\nchain of_a_test {{\n{chain}\n{lines}\n}}\n}}\n"
        done = subprocess.run(
            self.command(_tool("nft"), "-f", "-"), input=table, text=True, capture_output=True
        )
        if done.returncode:
            pytest.skip(f"nftables does not run here: {done.stderr}")


@contextmanager
def two_machines() -> Iterator[tuple[Machine, Machine]]:
    """Make a leader's machine and a node's, joined by a cable; skip the test where that cannot be."""
    if not hasattr(os, "geteuid") or os.geteuid() != 0 or shutil.which("ip", path=SEARCH_PATH) is None:
        pytest.skip("network namespaces need root and iproute2")
    pair = next(_PAIRS)
    leader, node = (Machine(f"simulshot-{os.getpid()}-{role}{pair}") for role in ("leader", "node"))
    _remove_leftovers()
    with ExitStack() as stack:
        for machine in (leader, node):
            _ip("netns", "add", machine.name)
            stack.callback(_ip, "netns", "delete", machine.name)
            machine.ip("link", "set", "lo", "up")
            if subprocess.run(machine.command("true"), capture_output=True).returncode:
                pytest.skip("no program can be started in a network namespace here")
        leader.ip("link", "add", "cable", "type", "veth", "peer", "cable", "netns", node.name)
        for machine, host in ((leader, LEADER_HOST), (node, NODE_HOST)):
            machine.ip("address", "add", f"{host}/24", "dev", "cable")
            machine.ip("link", "set", "cable", "up")
        yield leader, node


@contextmanager
def machines_on_cables(count: int) -> Iterator[tuple[Machine, list[tuple[Machine, str]]]]:
    """Make a machine with a cable of its own to each of so many others; those with their addresses.

    Skips the test where that cannot be.
    """
    if not hasattr(os, "geteuid") or os.geteuid() != 0 or shutil.which("ip", path=SEARCH_PATH) is None:
        pytest.skip("network namespaces need root and iproute2")
    pair = next(_PAIRS)
    hub, *others = (Machine(f"simulshot-{os.getpid()}-star{pair}-{number}") for number in range(count + 1))
    _remove_leftovers()
    with ExitStack() as stack:
        for machine in (hub, *others):
            _ip("netns", "add", machine.name)
            stack.callback(_ip, "netns", "delete", machine.name)
            machine.ip("link", "set", "lo", "up")
            if subprocess.run(machine.command("true"), capture_output=True).returncode:
                pytest.skip("no program can be started in a network namespace here")
        for number, machine in enumerate(others):
            near, net = f"cable{number}", f"10.78.{number}"
            hub.ip("link", "add", near, "type", "veth", "peer", "cable", "netns", machine.name)
            for end, name, host in ((hub, near, f"{net}.1"), (machine, "cable", f"{net}.2")):
                end.ip("address", "add", f"{host}/24", "dev", name)
                end.ip("link", "set", name, "up")
        yield hub, [(machine, f"10.78.{number}.2") for number, machine in enumerate(others)]


def _remove_leftovers() -> None:
    """Remove what killed runs left behind; the names carry their process."""
    for path in Path("/run/netns").glob("simulshot-*-*"):
        if not Path(f"/proc/{path.name.split('-')[1]}").exists():
            _ip("netns", "delete", path.name)


def _ip(*words: str) -> None:
    done = subprocess.run([_tool("ip"), *words], capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"no network namespaces here: {done.stderr.strip()}")


def _tool(name: str) -> str:
    return shutil.which(name, path=SEARCH_PATH) or name
