"""A rig of five kinds of cameras, each driven by its own driver, on one machine with one GigE cable.

What is real: the leader, the nodes, the gateway of phones, libaravis with the network below it, and the
browser. What is simulated: libcamera's module and its sensor, the inside of the GigE camera, the sensor of
the phone that is a node, the browser's picture. The replayed camera plays a recording.
"""

import json
import os
import subprocess
import sys
import threading
import time
from bisect import bisect
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from capture_app.session.format.manifest import ImageRecord
from capture_app.session.reading.reader import Session
from tests.browser import Browser
from tests.project import ROOT
from tests.unit.net.machines import Machine, machines_on_cables
from tests.unit.plugins.cameras.aravis.gige_rig import PICTURES, FakeCamera, build_sensor

LEADER = "127.0.0.1:47010"
TIMEOUT_S = 400.0
MATCH_NS = 100_000_000
BROWSER = (
    "--use-fake-device-for-media-stream=fps=30",
    "--use-fake-ui-for-media-stream",
    "--ignore-certificate-errors",
)


class MixedRig:
    """Its processes; `true_starts` are files of true starts of exposures, by the camera's name."""

    def __init__(self, machine: Machine, folder: Path) -> None:
        self.true_starts: dict[str, Path] = {}
        self._machine, self._folder = machine, folder
        self._running: list[subprocess.Popen[str]] = []
        self._urls: list[str] = []

    def start_leader(self) -> None:
        """Start the leader, which lets phones in."""
        where = ("--host", "127.0.0.1", "--port", "47010", "--sessions", "sessions")
        leader = self._start("-m", "capture_app.cli", "leader", *where, "--phones", "--json")
        threading.Thread(target=self._read_invitations, args=(leader,), daemon=True).start()

    def start_node(self, name: str, camera: str, *program: str) -> None:
        """Start a node by a clock of its own; `program` stands in for `capture-app`."""
        number = len(self._running)
        self._start(
            *(program or ("-m", "capture_app.cli")),
            *("node", "--name", name, "--leader", LEADER, "--camera", camera),
            *("--clock", f"sim:offset_s={3600 * number},skew_ppm={(15, -20, 5)[number % 3]}"),
        )

    def invitation(self) -> str:
        """The address in the QR code that the leader shows."""
        end_s = time.monotonic() + TIMEOUT_S
        while not self._urls:
            assert time.monotonic() < end_s, f"no invitation: {self.said()}"
            time.sleep(0.1)
        return self._urls[-1]

    def browser(self) -> Browser:
        """A browser on that machine."""
        return Browser(self._folder / "profile", *BROWSER, within=self._machine.command())

    def wait_until_ready(self, count: int) -> None:
        """Wait until so many cameras are ready."""
        end_s = time.monotonic() + TIMEOUT_S
        while True:
            done = self.run("status", "--leader", LEADER, "--json")
            nodes = json.loads(done.stdout)["nodes"] if done.returncode == 0 else []
            states = {node["name"]: node["state"] for node in nodes}
            if len(nodes) == count and set(states.values()) == {"ready"}:
                return
            assert time.monotonic() < end_s, f"not ready: {states}; {self.said()}"
            time.sleep(0.5)

    def burst(self, *options: str) -> Session:
        """Take a burst, and return its session."""
        done = self.run("burst", "--leader", LEADER, *options)
        assert done.returncode == 0, done.stderr
        return Session.open(self._folder / done.stdout.strip())

    def true_error_ns(self, image: ImageRecord) -> int:
        """The true start of a frame's exposure minus what the session has of it."""
        starts = self.true_starts[image.camera].read_text().splitlines()
        times_ns = sorted(int(line.split()[0]) for line in starts)
        place = bisect(times_ns, image.leader_ns)
        found = min(times_ns[max(0, place - 1) : place + 1], key=lambda at_ns: abs(at_ns - image.leader_ns))
        assert abs(found - image.leader_ns) < MATCH_NS, "no frame of that camera began near there"
        return found - image.leader_ns

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run `capture-app` there."""
        return subprocess.run(
            self._command("-m", "capture_app.cli", *words),
            cwd=self._folder,
            env=self._environment,
            capture_output=True,
            text=True,
            check=False,
        )

    def said(self) -> str:
        """The end of what each process said."""
        return "\n".join(path.read_text()[-1500:] for path in sorted(self._folder.glob("*.log")))

    def stop(self) -> None:
        """End all processes."""
        for process in reversed(self._running):
            process.terminate()
        for process in self._running:
            process.wait(TIMEOUT_S)
            if process.stdout is not None:
                process.stdout.close()

    def _read_invitations(self, leader: "subprocess.Popen[str]") -> None:
        assert leader.stdout is not None
        for line in leader.stdout:
            told = json.loads(line)
            if told.get("event") == "invitation":
                self._urls.append(told["url"])

    def _start(self, *words: str) -> "subprocess.Popen[str]":
        with (self._folder / f"{len(self._running)}.log").open("w") as log:
            process = subprocess.Popen(
                self._command(*words),
                cwd=self._folder,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE if "leader" in words else log,
                stderr=log,
                text=True,
            )
        self._running.append(process)
        return process

    def _command(self, *words: str) -> list[str]:
        return self._machine.command(sys.executable, *words)

    @property
    def _environment(self) -> dict[str, str]:
        folders = {f"XDG_{kind}_HOME": str(self._folder / kind) for kind in ("STATE", "DATA", "CONFIG")}
        return {**os.environ, **folders, "PYTHONUNBUFFERED": "1", "PYTHONPATH": str(ROOT)}


@contextmanager
def mixed_rig(folder: Path) -> Iterator[MixedRig]:
    """A leader and four nodes that run; a phone's browser is the test's own."""
    sensor = build_sensor(folder)
    with ExitStack() as stack:
        machine, ((camera_machine, host),) = stack.enter_context(machines_on_cables(1))
        rig = MixedRig(machine, folder)
        rig.true_starts = {name: folder / f"{name}.truth" for name in ("gige", "pi")}
        camera = FakeCamera(camera_machine, host, sensor, rig.true_starts["gige"], -25.0)
        camera.start()
        stack.callback(camera.kill)
        stack.callback(rig.stop)
        rig.start_leader()
        rig.start_node("gige", f"aravis:{host},{PICTURES}")
        pi = str(Path(__file__).with_name("libcamera_node.py"))
        rig.start_node("pi", "libcamera:0", pi, str(rig.true_starts["pi"]))
        rig.start_node("replay", f"replay:{ROOT / 'sample_sessions' / 'jumper'},camera=cam01")
        rig.start_node("sim", "sim:phone-b,scale=0.25")
        yield rig
