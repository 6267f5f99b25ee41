"""A rig of GigE Vision cameras: aravis's own fake ones, each behind a cable, on sensors that run freely.

The real library, driver and network stack; what is simulated is the camera's inside (free_running_sensor.c),
whose truth is written down.
"""

import json
import os
import shutil
import subprocess
import sys
import time
from bisect import bisect
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.errors import ExitCode, NotAvailableError
from capture_app.plugins.cameras.aravis.aravis_device import load_aravis
from capture_app.session.reading.reader import Session
from tests.unit.net.machines import Machine, machines_on_cables

FOLDER = Path(__file__).parent
TIMEOUT_S = 300.0
PICTURES = "width=64,height=48,exposure_us=5000"
"""So small that a frame is of 5 packets: the fake camera sends none again that was lost, as real ones do."""
MATCH_NS = 5_000_000


def load_or_skip() -> Any:
    """Return the library; skip the test where there is none."""
    try:
        return load_aravis()
    except NotAvailableError as error:
        pytest.skip(str(error))


def build_sensor(folder: Path) -> Path:
    """Compile what is preloaded into the fake cameras; skip the test where that cannot be."""
    load_or_skip()
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler here; apt-get install gcc")
    built = folder / "free_running_sensor.so"
    options = ("-shared", "-fPIC", "-O2", "-Wall", "-Werror", "-o", str(built))
    source = str(FOLDER / "free_running_sensor.c")
    subprocess.run([compiler, *options, source, "-ldl", "-lm"], check=True)
    return built


class FakeCamera:
    """One fake camera on a machine of its own, that can be killed and started again."""

    def __init__(self, machine: Machine, host: str, sensor: Path, truth: Path, ppm: float) -> None:
        self.machine, self.host = machine, host
        self._truth, self._sensor, self._ppm = truth, sensor, ppm
        self._process: subprocess.Popen[str]

    def start(self) -> None:
        """Switch it on."""
        self._process = self.machine.start_python(
            str(FOLDER / "fake_camera.py"),
            "cable",
            self.host,
            LD_PRELOAD=str(self._sensor),
            SENSOR_PPM=str(self._ppm),
            SENSOR_TRUTH=str(self._truth),
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "runs\n"

    def kill(self) -> None:
        """Switch it off, as a cut power cable would."""
        self._process.kill()
        self._process.communicate()

    def true_starts_ns(self) -> list[int]:
        """When its frames began, in the host's clock."""
        return sorted(int(line.split()[0]) for line in self._truth.read_text().splitlines())


class GigeRig:
    """A leader and a node for each camera, as processes of one machine, with clocks of their own."""

    def __init__(self, machine: Machine, cameras: dict[str, FakeCamera], folder: Path) -> None:
        self.cameras = cameras
        self._machine, self._folder = machine, folder
        self._running: list[subprocess.Popen[str]] = []

    def start(self) -> None:
        """Start the leader, and the nodes by clocks that are hours apart and run differently."""
        self._start("leader", "--host", "127.0.0.1", "--port", "47010", "--sessions", "sessions")
        for number, (name, camera) in enumerate(self.cameras.items()):
            self._start(
                *("node", "--name", name, "--leader", "127.0.0.1:47010"),
                *("--camera", f"aravis:{camera.host},{PICTURES}"),
                *("--clock", f"sim:offset_s={3600 * number},skew_ppm={(15, -20, 5)[number % 3]}"),
            )

    def status(self) -> dict[str, Any]:
        """What the leader shows; empty before it answers."""
        done = self._run("status", "--leader", "127.0.0.1:47010", "--json")
        return json.loads(done.stdout) if done.returncode == 0 else {"nodes": []}

    def wait(self, what: str, holds: Callable[[dict[str, dict[str, Any]]], object]) -> None:
        """Wait until something holds of the nodes by name."""
        end_s = time.monotonic() + TIMEOUT_S
        while True:
            nodes = {node["name"]: node for node in self.status()["nodes"]}
            if holds(nodes):
                return
            assert time.monotonic() < end_s, f"never {what}: {nodes}; {self.said()}"
            time.sleep(0.5)

    def wait_until_ready(self) -> None:
        """Wait until all cameras are ready."""
        self.wait(
            "ready",
            lambda nodes: (
                len(nodes) == len(self.cameras) and all(node["state"] == "ready" for node in nodes.values())
            ),
        )

    def burst(self, *options: str, may_lack: bool = False) -> Session:
        """Take a burst, and return its session; `may_lack` images."""
        done = self._run("burst", "--leader", "127.0.0.1:47010", *options)
        fine = (ExitCode.OK, ExitCode.INCOMPLETE) if may_lack else (ExitCode.OK,)
        assert done.returncode in fine, done.stderr
        return Session.open(self._folder / done.stdout.strip())

    def true_errors_ns(self, session: Session) -> list[dict[str, int]]:
        """For each instant, each camera's true start of the exposure minus what the session has of it."""
        truths = {name: camera.true_starts_ns() for name, camera in self.cameras.items()}
        return [
            {
                name: _nearest(truths[name], image.leader_ns) - image.leader_ns
                for name, image in images.items()
            }
            for images in session.images_by_instant()
        ]

    def said(self) -> str:
        """The end of what each process said."""
        return "\n".join(path.read_text()[-1500:] for path in sorted(self._folder.glob("*.log")))

    def stop(self) -> None:
        """End all processes."""
        for process in self._running:
            process.terminate()
        for process in self._running:
            process.wait(TIMEOUT_S)

    def _start(self, *words: str) -> None:
        log = (self._folder / f"{len(self._running)}.log").open("w")
        command = self._machine.command(sys.executable, "-m", "capture_app.cli", *words)
        self._running.append(
            subprocess.Popen(
                command, cwd=self._folder, env=self._environment, stdout=log, stderr=log, text=True
            )
        )
        log.close()

    def _run(self, *words: str) -> subprocess.CompletedProcess[str]:
        command = self._machine.command(sys.executable, "-m", "capture_app.cli", *words)
        return subprocess.run(
            command, cwd=self._folder, env=self._environment, capture_output=True, text=True, check=False
        )

    @property
    def _environment(self) -> dict[str, str]:
        folders = {f"XDG_{kind}_HOME": str(self._folder / kind) for kind in ("STATE", "DATA", "CONFIG")}
        return {**os.environ, **folders, "PYTHONUNBUFFERED": "1"}


@contextmanager
def gige_rig(folder: Path, ppm: dict[str, float]) -> Iterator[GigeRig]:
    """A rig that runs; `ppm` is the error of each camera's crystal by its name."""
    sensor = build_sensor(folder)
    with ExitStack() as stack:
        rig_machine, machines = stack.enter_context(machines_on_cables(len(ppm)))
        cameras = {}
        for name, (machine, host) in zip(ppm, machines, strict=True):
            camera = cameras[name] = FakeCamera(machine, host, sensor, folder / f"{name}.truth", ppm[name])
            camera.start()
            stack.callback(camera.kill)
        rig = GigeRig(rig_machine, cameras, folder)
        stack.callback(rig.stop)
        rig.start()
        yield rig


def _nearest(times_ns: list[int], at_ns: int) -> int:
    place = bisect(times_ns, at_ns)
    found = min(times_ns[max(0, place - 1) : place + 1], key=lambda time_ns: abs(time_ns - at_ns))
    assert abs(found - at_ns) < MATCH_NS, "no frame of that camera began near there"
    return found
