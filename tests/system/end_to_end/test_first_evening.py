"""A first evening with two machines on one network, by the commands that one types."""

import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from tests.unit.net.machines import LEADER_HOST, NOBODY, Machine, two_machines

CAMERA = ("--camera", "sim:phone-a", "--clock", "sim")


class Evening:
    """Two machines, each with a user and folders of its own."""

    def __init__(self, leader: Machine, node: Machine, folder: Path, stack: ExitStack) -> None:
        self.leader, self.node, self._folder, self._stack = leader, node, folder, stack

    def start(self, machine: Machine, *words: str, skips_pairing: bool = False) -> subprocess.Popen[str]:
        """Start `capture-app` there; it ends with the test."""
        home = self._folder / machine.name
        names = {"XDG_STATE_HOME": "state", "XDG_DATA_HOME": "data", "XDG_CONFIG_HOME": "config"}
        folders = {name: str(home / part) for name, part in names.items()}
        folders["SIMULSHOT_OPEN"] = str(int(skips_pairing))
        program = machine.start_python("-m", "capture_app.cli", *words, **folders)
        self._stack.callback(self._end, program)
        return program

    def lead(self, *words: str) -> subprocess.Popen[str]:
        """Start a leader, and wait until it listens."""
        program = self.start(self.leader, "leader", "--sessions", str(self._folder / "sessions"), *words)
        said(program, "leader at")
        return program

    def join(self, name: str, *words: str) -> subprocess.Popen[str]:
        """Start a node."""
        return self.start(self.node, "node", "--name", name, *CAMERA, *words)

    @staticmethod
    def _end(program: subprocess.Popen[str]) -> None:
        program.kill()
        program.communicate()


def said(program: subprocess.Popen[str], text: str) -> str:
    """Wait for a line with that text."""
    assert program.stdout is not None
    before = []
    for line in program.stdout:
        before.append(line)
        if text in line:
            return line
    raise AssertionError(f"it ended without {text!r}: {before}")


@contextmanager
def evening(folder: Path) -> Iterator[Evening]:
    with two_machines() as machines, ExitStack() as stack:
        yield Evening(*machines, folder, stack)


def test_nothing_is_waited_for_in_silence(tmp_path: Path) -> None:
    with evening(tmp_path) as two:
        early, lost = two.join("early"), two.join("lost", "--leader", NOBODY)
        before = two.join("before", "--leader", LEADER_HOST)
        said(early, "looking for a leader in this network")
        assert "start one with: capture-app" in said(early, "no leader found on this network yet")
        assert "capture-app doctor" in said(lost, f"no machine answers at {NOBODY}")
        assert "start it there with: capture-app" in said(
            before, f"{LEADER_HOST} is reachable, but no leader"
        )
        two.lead()
        assert said(early, f"found a leader at {LEADER_HOST}:47010")
        for node in (early, before):
            line = said(node, f"this machine does not know the leader at {LEADER_HOST}:47010")
            assert "capture-app trust pair" in line


def test_a_node_joins_the_open_leader_of_its_network(tmp_path: Path) -> None:
    with evening(tmp_path) as two:
        leader = two.lead("--open")
        node = two.join("cam", "--open")
        said(node, f"found a leader at {LEADER_HOST}:47010")
        said(leader, "cam joined")
        question = ("doctor", "--leader", LEADER_HOST, "--json")
        doctor, _ = two.start(two.node, *question, skips_pairing=True).communicate()
        assert f"the leader at {LEADER_HOST}:47010 answers" in doctor
