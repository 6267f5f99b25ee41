"""A small scene with exact truth, textured boards of which one moves; and the command line."""

import json
import zlib
from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import BurstRecord, CameraRecord
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from reconstruction import cli
from reconstruction.common.geometry import Array, View
from tests.facts import make_facts

WIDTH, HEIGHT, FOCAL = 320, 240, 300.0
PERIOD_NS = 33_333_333
TEXELS = 300


@cache
def texture(seed: int, size: int = 512) -> Array:
    """Noise at many scales with hard-edged spots, uint8 size x size."""
    rng = np.random.default_rng(seed)
    image = np.zeros((size, size), np.float32)
    for octave in range(2, 9):
        cells = rng.random((2**octave, 2**octave), dtype=np.float32)
        image += 0.75**octave * cv2.resize(cells, (size, size), interpolation=cv2.INTER_CUBIC)
    image = (image - image.min()) / np.ptp(image)
    for _ in range(60):
        at, radius = rng.integers(0, size, 2), int(rng.integers(4, size // 24))
        cv2.circle(image, (int(at[0]), int(at[1])), radius, float(rng.random()), -1)
    painted = (30 + 200 * image).astype(np.uint8)
    painted.flags.writeable = False
    return painted


@dataclass
class Board:
    """A board facing +z of the rig: its left, top, right, bottom and depth; it may move with time."""

    box: tuple[float, float, float, float]
    z: float
    paint: Array
    path: Callable[[float], tuple[float, float]] | None = None


@dataclass
class Scene:
    """Boards, and how to look at them."""

    boards: list[Board]
    noise: float = 1.0

    def look(self, view: View, time: float, unit: float = 1.0) -> tuple[Array, Array, Array]:
        """Grey image (uint8), depth along the view's axis in `unit`s and movers at a time in periods."""
        rays = view.rays(view.grid())
        centre = view.centre / unit
        across, down, away = np.ascontiguousarray((rays @ view.rotation).T)
        image = np.zeros(len(rays), np.float32)
        depth = np.full(len(rays), np.inf)
        movers = np.zeros(len(rays), bool)
        shape = (view.height, view.width)
        for board in self.boards:
            reach = (board.z - centre[2]) / away
            path = board.path(time) if board.path else (0.0, 0.0)
            x, y = (centre[k] + reach * ray - path[k] for k, ray in enumerate((across, down)))
            left, top, right, bottom = board.box
            hit = (reach > 0) & (reach < depth) & (x > left) & (x < right) & (y > top) & (y < bottom)
            # Only the rows that see the board are painted, which takes most of the time.
            if not (rows := np.flatnonzero(hit.reshape(shape).any(axis=1))).size:
                continue
            part = slice(rows[0] * view.width, (rows[-1] + 1) * view.width)
            hit = hit[part]
            xs, ys = (
                np.mod((one[part] * TEXELS).astype(np.float32), board.paint.shape[0] - 1) for one in (x, y)
            )
            width = -1, view.width
            colour = cv2.remap(board.paint, xs.reshape(width), ys.reshape(width), cv2.INTER_LINEAR).ravel()
            image[part][hit], depth[part][hit] = colour[hit], reach[part][hit]
            movers[part][hit] = board.path is not None
        # Noise of this camera at this time, whatever other tests have looked at before.
        seed = zlib.crc32(view.rotation.tobytes() + view.translation.tobytes() + np.float64(time).tobytes())
        image += np.random.default_rng(seed).normal(0, self.noise, len(rays)).astype(np.float32)
        return (
            np.clip(image, 0, 255).astype(np.uint8).reshape(shape),
            (depth * unit).astype(np.float32).reshape(shape),
            movers.reshape(shape),
        )


def jump(time: float) -> tuple[float, float]:
    """0.05 across and 0.09 up with every period."""
    return 0.05 * time - 0.1, 0.25 - 0.09 * time


@pytest.fixture(autouse=True)
def own_data_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Calibrations that one test keeps are not found by another."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))


@pytest.fixture(scope="session")
def scene() -> Scene:
    """A wall, three boards at rest, and one that jumps."""
    return Scene(
        [
            Board((-9, -9, 9, 9), 4.0, texture(1)),
            Board((-1.6, 0.2, -0.9, 1.4), 3.0, texture(2)),
            Board((0.9, -0.2, 1.5, 1.3), 2.6, texture(3)),
            Board((-0.7, -1.2, 0.2, -0.75), 3.4, texture(4)),
            Board((-0.3, -0.3, 0.3, 0.3), 2.2, texture(5), jump),
        ]
    )


def make_view(
    at: tuple[float, float, float],
    *,
    yaw: float = 0.0,
    pitch: float = 0.0,
    roll: float = 0.0,
    distortion: tuple[float, ...] = (0, 0, 0, 0, 0),
    unit: float = 1.0,
) -> View:
    """A camera at a place of the rig (in scene units), turned by angles in degrees."""
    rotation = np.eye(3)
    for axis, angle in enumerate((pitch, -yaw, roll)):
        vector = np.zeros(3)
        vector[axis] = np.radians(angle)
        rotation = cv2.Rodrigues(vector)[0] @ rotation
    matrix = np.array([[FOCAL, 0, WIDTH / 2 - 3.5], [0, FOCAL * 1.01, HEIGHT / 2 + 2.0], [0, 0, 1]])
    return View(WIDTH, HEIGHT, matrix, np.array(distortion, float), rotation, -rotation @ np.array(at) * unit)


def write_session(
    root: Path,
    scene: Scene,
    views: dict[str, View],
    *,
    instants: int = 5,
    calibrated: bool = True,
    truth: bool = True,
    frozen: bool = False,
    missing: Container[tuple[str, int]] = (),
    late: Mapping[str, float] | None = None,
    steps: Mapping[str, float] | None = None,
    moved: Callable[[View, float], View] = lambda view, time: view,
) -> Session:
    """A simulated session of a scene; `frozen` lets nothing move, `missing` images are left out.

    `late`: periods by which a camera's pictures are later than their times say; `steps`: planned delays in
    periods; `moved`: where a camera stands at a time.
    """
    delays_ns = {name: round(periods * PERIOD_NS) for name, periods in (steps or {}).items()}
    writer = SessionWriter.create(root, "boards")
    for k in range(instants):
        for name, view in views.items():
            if (name, k) in missing:
                continue
            delay_ns = delays_ns.get(name, 0)
            time = 0.0 if frozen else k + (late or {}).get(name, 0.0) + delay_ns / PERIOD_NS
            image, depth, movers = scene.look(moved(view, time), time)
            known: dict[str, Any] = {}
            if truth:
                packed = BytesIO()
                np.savez(packed, depth_m=depth, objects=movers.astype(np.uint8), movers=movers)
                known = {"truth": packed.getvalue(), "true_ns": k * PERIOD_NS}
            add_image(writer, name, k, image, delay_ns=delay_ns, **known)
    if calibrated:
        writer.set_calibration(
            Calibration(cameras={name: v.to_calibration() for name, v in views.items()}, source="boards")
        )
    return finish_session(writer, views, instants, delays_ns)


def add_image(
    writer: SessionWriter, name: str, instant: int, image: Array, *, delay_ns: int = 0, **truth: Any
) -> None:
    """One camera's image (grey, uint8) of an instant."""
    data, at_ns = cv2.imencode(".png", image)[1].tobytes(), instant * PERIOD_NS + delay_ns
    writer.add_image(data, camera=name, instant=instant, leader_ns=at_ns, suffix=".png", **truth)


def finish_session(
    writer: SessionWriter, names: Iterable[str], instants: int, delays_ns: Mapping[str, int] | None = None
) -> Session:
    """A session of these cameras, whose images are written."""
    facts = make_facts(width=WIDTH, height=HEIGHT, period_ns=PERIOD_NS)
    burst = BurstRecord(instants_ns=tuple(k * PERIOD_NS for k in range(instants)), period_ns=PERIOD_NS)
    delays_ns = delays_ns or {}
    cameras = [CameraRecord(name=name, facts=facts, delay_ns=delays_ns.get(name, 0)) for name in names]
    return writer.finish(cameras, burst, origin="simulated")


VIEWS = {
    "left": make_view((-0.1, 0.0, 0.0), yaw=1.5),
    "right": make_view((0.1, 0.01, 0.0), yaw=-1.5),
    "aside": make_view((0.12, 0.0, 0.0), yaw=24),
}


@pytest.fixture(scope="session")
def boards(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Session:
    """A calibrated session with truth: a stereo pair, and a camera that looks aside."""
    return write_session(tmp_path_factory.mktemp("sessions"), scene, VIEWS)


@dataclass
class Outcome:
    """What a run of the command line printed, and how it ended."""

    code: int
    out: str
    err: str

    @property
    def result(self) -> Any:
        """The JSON that a run without errors printed."""
        assert self.code == 0, self.err
        return json.loads(self.out)

    @property
    def complaint(self) -> str:
        """The one line on stderr, beside those of progress, that says what is wrong."""
        talk = ("[", "first pictures")
        (line,) = (line for line in self.err.splitlines() if not line.startswith(talk))
        assert line.startswith("reconstruct: error: ")
        return line


Reconstruct = Callable[..., Outcome]


@pytest.fixture
def reconstruct(capsys: pytest.CaptureFixture[str]) -> Reconstruct:
    """Run the command line."""

    def run(*arguments: object) -> Outcome:
        code = cli.run([str(argument) for argument in arguments])
        printed = capsys.readouterr()
        return Outcome(code, printed.out, printed.err)

    return run
