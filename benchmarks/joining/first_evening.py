"""How soon a node that cannot join says why, and how soon a leader is found: real processes on two machines.

The machines are network namespaces on one cable, the firewalls nftables', the cameras simulated. Each time
is from the start of the process to the sentence, the worst of several. Needs root, iproute2 and nftables.
"""

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarks.emulated_link.network import CAPTURE_APP, SEARCH_PATH, Network, in_namespace
from benchmarks.report import new_parser, print_report, print_rows

LEADER, NODE, NOBODY, ELSEWHERE = "10.77.0.1", "10.77.0.2", "10.77.0.99", "10.99.0.1"
NO_UDP, SHUT, OTHER = 47020, 47030, 47090
"""Ports of leaders: one that UDP does not reach, one that nothing reaches, one of another version."""
PROMISED_S = 5.0
OTHER_VERSION = f"""
import socket
datagrams = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
datagrams.bind(("", {OTHER}))
streams = socket.create_server(("", {OTHER}))
print("ready", flush=True)
while True:
    data, where = datagrams.recvfrom(2048)
    if len(data) >= 12 and data[2] != 3:
        datagrams.sendto(data[:2] + bytes((3, 0)) + data[4:12], where)
"""


@dataclass(frozen=True)
class Case:
    """What a node is started with, and what it then says."""

    name: str
    words: tuple[str, ...]
    says: str


BEFORE = (
    Case("before its leader, no address", (), "no leader is found in this network yet"),
    Case("before its leader, its address", ("--leader", LEADER), "no leader listens on its port"),
    Case("at an address that nobody has", ("--leader", NOBODY), "no machine answers at"),
    Case("at an address of no network here", ("--leader", ELSEWHERE), "no network that leads to"),
    Case("on another version", ("--leader", f"{LEADER}:{OTHER}"), "speaks version 3 of the protocol"),
)
FOUND = (Case("finds its leader by itself", (), "found a leader at"),)
WITH_LEADER = (
    Case("unpaired", ("--leader", LEADER), "does not know the leader at"),
    Case("firewall there, UDP", ("--leader", f"{LEADER}:{NO_UDP}"), "answers no datagram"),
    Case("firewall there, all", ("--leader", f"{LEADER}:{SHUT}"), "a firewall drops what is sent"),
)
OWN_FIREWALL = (Case("firewall of its own", ("--leader", LEADER), "own firewall lets nothing out"),)


class Evening:
    """The two machines, and users of theirs who have paired nothing."""

    def __init__(self, network: Network) -> None:
        self.leader, self.node = network.namespace("leader"), network.namespace("node")
        network.cable(self.leader, f"{LEADER}/24", self.node, f"{NODE}/24")
        self._folder = Path(tempfile.mkdtemp(dir=network.scratch))

    def start(self, machine: str, *command: str) -> "subprocess.Popen[str]":
        """Start a program; what it says comes as it says it."""
        home = self._folder / machine
        state = {f"XDG_{kind}_HOME": str(home / kind.lower()) for kind in ("STATE", "DATA", "CONFIG")}
        words = [f"{name}={value}" for name, value in {**state, "SIMULSHOT_OPEN": "0"}.items()]
        return subprocess.Popen(
            in_namespace(machine, "env", "PYTHONUNBUFFERED=1", *words, *command),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    @contextmanager
    def running(self, machine: str, ready: str, *command: str) -> Iterator[None]:
        """Run a program until the block ends; it begins when the program has said that it is ready."""
        program = self.start(machine, *command)
        try:
            _seconds_until(program, ready)
            yield
        finally:
            program.kill()
            program.wait()

    @contextmanager
    def leading(self, port: int) -> Iterator[None]:
        """Run a leader."""
        sessions = str(self._folder / f"sessions-{port}")
        words = ("leader", "--sessions", sessions, "--port", str(port))
        with self.running(self.leader, "leader at", *CAPTURE_APP, *words):
            yield

    def drop(self, machine: str, hook: str, *rules: str) -> None:
        """Let a machine's firewall drop what the rules name."""
        lines = "\n".join(rules)
        chain = f"chain of_the_benchmark {{\ntype filter hook {hook} priority 0;\n{lines}\n}}"
        table = f"table inet simulshot {{\n{chain}\n}}\n"
        nft = shutil.which("nft", path=SEARCH_PATH)
        if nft is None:
            raise SystemExit("nft is missing; type: sudo apt-get install nftables")
        subprocess.run(in_namespace(machine, nft, "-f", "-"), input=table, text=True, check=True)

    def measure(self, cases: Sequence[Case], repeats: int) -> dict[str, float]:
        """Return the worst time of each case in seconds."""
        return {case.name: max(self._measure(case) for _ in range(repeats)) for case in cases}

    def _measure(self, case: Case) -> float:
        spool = str(self._folder / "spool")
        camera = ("--name", "cam", "--camera", "sim:phone-a", "--clock", "sim", "--spool", spool)
        program = self.start(self.node, *CAPTURE_APP, "node", *camera, *case.words)
        try:
            return _seconds_until(program, case.says)
        finally:
            program.kill()
            program.wait()


def _seconds_until(program: "subprocess.Popen[str]", text: str) -> float:
    began_s, said = time.monotonic(), []
    assert program.stdout is not None
    for line in program.stdout:
        said.append(line)
        if text in line:
            return time.monotonic() - began_s
    raise SystemExit(f"it ended without {text!r}: {said}")


def main() -> None:
    """Measure, and print a table; fail where a sentence takes longer than promised."""
    parser = new_parser(__doc__)
    parser.add_argument("--repeats", type=int, default=5, help="nodes for each case (5)")
    options = parser.parse_args()
    times: dict[str, float] = {}
    with Network() as network:
        evening = Evening(network)
        with evening.running(evening.leader, "ready", sys.executable, "-c", OTHER_VERSION):
            times |= evening.measure(BEFORE, options.repeats)
        with evening.leading(47010):
            times |= evening.measure(FOUND, options.repeats)
        with evening.leading(47010), evening.leading(NO_UDP), evening.leading(SHUT):
            shut = f"meta l4proto {{tcp, udp}} th dport {SHUT} drop"
            evening.drop(evening.leader, "input", f"udp dport {NO_UDP} drop", shut)
            times |= evening.measure(WITH_LEADER, options.repeats)
            evening.drop(evening.node, "output", "udp dport 47010 drop")
            times |= evening.measure(OWN_FIREWALL, options.repeats)
    rows = [{"case": name, "worst_s": round(seconds, 2)} for name, seconds in times.items()]
    columns = {"case": ("a node", "s"), "worst_s": (f"worst of {options.repeats}, s", ".1f")}
    print_report({"cases": rows}, lambda report: print_rows(report["cases"], columns), as_json=options.json)
    if max(times.values()) > PROMISED_S:
        raise SystemExit(f"one took longer than {PROMISED_S:g} s")


if __name__ == "__main__":
    main()
