"""Network namespaces of one benchmark run, the links between them, and the processes inside.

All namespaces share one kernel clock, so the true offset between any two nodes is known to be 0. Their names
contain this process's id. Two runs can therefore coexist, and the next run removes what a killed run left.
"""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from .delays import EmulatedLink

ROOT = Path(__file__).resolve().parents[2]
CAPTURE_APP = (sys.executable, "-m", "capture_app.cli")
SEARCH_PATH = os.environ.get("PATH", os.defpath) + ":/usr/sbin:/sbin"
_NAMESPACES = Path("/run/netns")
_PREFIX = "simulshot"
_PACKAGES = {"ip": "iproute2", "cc": "gcc libc6-dev"}
_END_S = 20.0


def what_is_missing(*, is_root: bool, search_path: str = SEARCH_PATH) -> str:
    """Return what this machine lacks for an emulated network, with the command to type; empty if nothing."""
    if not sys.platform.startswith("linux"):
        return "an emulated network needs Linux"
    for tool, packages in _PACKAGES.items():
        if shutil.which(tool, path=search_path) is None:
            return f"{tool} is missing; type: sudo apt-get install {packages}"
    if not is_root:
        return "network namespaces need root; type: sudo make TARGET, with the target you have just typed"
    return ""


class Network:
    """Namespaces and their links, as a context manager; raises SystemExit if they cannot be made.

    `scratch` is a temporary folder. `air` is the namespace in which emulated links are forwarded.
    """

    def __init__(self) -> None:
        if missing := what_is_missing(is_root=os.geteuid() == 0):
            raise SystemExit(missing)
        self._stack = contextlib.ExitStack()
        self._cables = 0

    def __enter__(self) -> "Network":
        """Remove what killed runs left behind, and compile the emulator."""
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
        _remove_leftovers()
        self.scratch = Path(self._stack.enter_context(tempfile.TemporaryDirectory()))
        source = Path(__file__).with_name("emulator.c")
        _call("cc", "-O2", "-o", str(self.scratch / "emulator"), str(source), "-lm")
        self.air = self.namespace("air")
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the namespaces, and with them all devices inside."""
        self._stack.close()

    def keep_user_files(self) -> None:
        """Store the user state and keys of all later commands in `scratch`.

        This applies to all commands, because clients of a leader must belong to the leader's user.
        """
        os.environ |= {"XDG_STATE_HOME": str(self.scratch), "XDG_DATA_HOME": str(self.scratch)}

    def namespace(self, name: str) -> str:
        """Create a namespace, and return its full name."""
        full_name = f"{_PREFIX}-{os.getpid()}-{name}"
        _call("ip", "netns", "add", full_name)
        self._stack.callback(_remove_namespace, full_name)
        _ip_in(full_name, "link", "set", "lo", "up")
        return full_name

    def cable(self, one: str, one_address: str, other: str, other_address: str) -> None:
        """Join two namespaces by a plain veth cable; addresses are IPv4 with a prefix length."""
        device = self._add_veth(one, other)
        _set_up(one, device, one_address)
        _set_up(other, device, other_address)

    def link_end(self, namespace: str, address: str = "") -> str:
        """Create one end of an emulated link; return it in the form of `EmulatedLink`."""
        device = self._add_veth(namespace, self.air)
        _ip_in(self.air, "link", "set", device, "addrgenmode", "none", "up")
        _set_up(namespace, device, address)
        return f"{namespace}/{device}"

    @contextlib.contextmanager
    def emulation(
        self, links: Sequence[EmulatedLink], seed: int, *, loss: float = 0.0
    ) -> Iterator[list[dict[str, Any]]]:
        """Forward frames over the links inside the block; then the list holds each direction's report."""
        options = ["-s", str(seed), "-l", str(loss), *EmulatedLink.OPTIONS]
        words = [word for link in links for word in link.words()]
        command = [str(self.scratch / "emulator"), *options, self.air, *words]
        reports: list[dict[str, Any]] = []
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            if process.stdout.readline() != "ready\n":
                raise SystemExit("the link's emulator did not start, see above")
            try:
                yield reports
            finally:
                process.terminate()
                asked = [way for link in links for way in link.ways()]
                for line, (end, delays) in zip(process.stdout, asked, strict=True):
                    reports.append(json.loads(line) | {"to": end, "asked_mean_us": delays.mean_us})

    def _add_veth(self, one: str, other: str) -> str:
        """Create a veth cable between two namespaces; return its device's name, the same in both."""
        self._cables += 1
        device = f"cable{self._cables}"
        _ip_in(one, "link", "add", device, "type", "veth", "peer", "name", device, "netns", other)
        return device


def in_namespace(namespace: str, *command: str) -> list[str]:
    """Return the command that runs another command in a namespace."""
    return [_tool("ip"), "netns", "exec", namespace, *command]


@contextlib.contextmanager
def running(namespace: str, *command: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a command in a namespace until the block ends."""
    process = subprocess.Popen(
        in_namespace(namespace, *command),
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.terminate()
        process.wait(timeout=_END_S)


def read_output(namespace: str, *command: str) -> str:
    """Run a command in a namespace and return its output. Raises SystemExit if it fails."""
    there = in_namespace(namespace, *command)
    done = subprocess.run(there, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"`{' '.join(command)}` failed with exit code {done.returncode}")
    return done.stdout


def _set_up(namespace: str, device: str, address: str) -> None:
    if address:
        _ip_in(namespace, "addr", "add", address, "dev", device)
    _ip_in(namespace, "link", "set", device, "up")


def _ip_in(namespace: str, *arguments: str) -> None:
    _call("ip", "-n", namespace, *arguments)


def _tool(name: str) -> str:
    return shutil.which(name, path=SEARCH_PATH) or name


def _call(tool: str, *arguments: str) -> str:
    done = subprocess.run([_tool(tool), *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        hint = "; a container must be started with --privileged" if tool == "ip" else ""
        raise SystemExit(f"`{tool} {' '.join(arguments)}` failed: {' '.join(done.stderr.split())}{hint}")
    return done.stdout


def _remove_leftovers() -> None:
    for path in _NAMESPACES.glob(f"{_PREFIX}-*-*"):
        if not Path(f"/proc/{path.name.split('-')[1]}").exists():
            _remove_namespace(path.name)


def _remove_namespace(name: str) -> None:
    """End the processes that still run in a namespace, and remove it."""
    for pid in _call("ip", "netns", "pids", name).split():
        with contextlib.suppress(ProcessLookupError):
            os.kill(int(pid), signal.SIGKILL)
    _call("ip", "netns", "del", name)
