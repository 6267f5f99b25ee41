"""Headlines of rigs of three and five cameras of which one is late: is it named, by how much, and alone?

    python -m benchmarks.reconstruction.rig_verdicts --cache FOLDER

Painted boards before three and five cameras, of which one, by the seed, is late by a part of a frame or by
whole frames; with --steady rigs on time, and with one camera that jitters or drops a frame. A headline is
right if it says that the cameras were not synchronized, each offset holds the truth within its error, and no
camera is certified falsely. Simulated.
"""

import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reconstruction import painted_scenes
from benchmarks.reconstruction.painted_scenes import FOCAL, HEIGHT, WIDTH, Stage
from benchmarks.reconstruction.verdict_takes import PERIOD_MS, add_image, finish
from benchmarks.report import new_parser, print_rows, talk
from capture_app.session.writing.session_writer import SessionWriter
from reconstruction.common.geometry import Array, View, look_along
from reconstruction.compare.comparison import CompareOptions, compare
from reconstruction.method.comparison_results import CompareResult
from reconstruction.method.timing import Timing

COLUMNS = {
    "rig": ("cameras", ""),
    "late": ("late", ""),
    "truth_ms": ("by ms", ".1f"),
    "headline": ("headline", ""),
    "right": ("right", ""),
}
LATE_MS = (PERIOD_MS, 10.0, -PERIOD_MS, 2 * PERIOD_MS, -14.0)
NOT_SYNCHRONIZED = "These cameras were not synchronized"


@dataclass(frozen=True)
class RigTake:
    """A rig's take; camera `late` is late by `late_ms`, jitters (uniform, either way), or drops a frame."""

    cameras: int
    seed: int
    late_ms: float = 0.0
    jitter_ms: float = 0.0
    drop: int = 0
    frames: int = 14

    @property
    def name(self) -> str:
        """Folder name of its session."""
        off = f"{self.late_ms:.0f}-{self.jitter_ms:.0f}-{self.drop}".replace("-", "m", self.late_ms < 0)
        return f"rig-{self.cameras}-{self.seed}-{off}-{self.frames}"

    @property
    def late(self) -> str:
        """Name of the camera that is not on time."""
        return f"cam{(2 * self.seed + self.cameras) % self.cameras}"

    def delays_ms(self, camera: str) -> Array:
        """Return a camera's delay at each instant (frames,) ms."""
        k = np.arange(self.frames)
        drawn = np.random.default_rng([self.seed, 9]).uniform(-1, 1, self.frames)
        own = self.late_ms + self.jitter_ms * drawn + PERIOD_MS * ((k >= self.drop) & (self.drop > 0))
        return np.asarray(own * (camera == self.late))


def views_of(cameras: int) -> dict[str, View]:
    """Return cameras on an arc that look at what is 3.5 m ahead, every other one 8 cm higher."""
    matrix = np.array([[FOCAL, 0, WIDTH / 2 - 0.5], [0, FOCAL, HEIGHT / 2 - 0.5], [0, 0, 1]])
    views = {}
    for k in range(cameras):
        x, y = 0.22 * (k - (cameras - 1) / 2), -0.08 * (k % 2)
        ahead = np.array([-x, -y, 3.5]) / np.linalg.norm([x, y, 3.5])
        rotation = look_along(ahead, np.array([0.0, 1.0, 0.0]))
        place = np.array([x, y, 0.0])
        views[f"cam{k}"] = View(WIDTH, HEIGHT, matrix, np.zeros(5), rotation, -rotation @ place)
    return views


def stage_of(seed: int) -> Stage:
    """Return swinging boards: of several sizes and speeds, by the seed."""
    kinds: tuple[dict[str, Any], ...] = (
        {},
        {"movers": 1, "size_m": 1.6},
        {"speed_m_s": 0.8},
        {"movers": 2},
        {"movers": 4, "size_m": 0.45},
    )
    return painted_scenes.room(seed, **kinds[seed % len(kinds)])


def late_takes() -> Iterator[RigTake]:
    """Yield ten takes of three cameras and ten of five, each with one camera late."""
    for seed in range(10):
        for cameras in (3, 5):
            yield RigTake(cameras, seed, late_ms=LATE_MS[(seed + cameras) % len(LATE_MS)])


def other_takes() -> Iterator[RigTake]:
    """Yield rigs on time, and with one camera that jitters or drops a frame."""
    for seed in range(4):
        for cameras in (3, 5):
            yield RigTake(cameras, seed)
            yield RigTake(cameras, seed, jitter_ms=12.0)
            yield RigTake(cameras, seed, drop=7 + seed, frames=20)


def judge(take: RigTake, result: CompareResult) -> dict[str, Any]:
    """Compare what is said of a rig with the truth."""
    rig = result.rig_timing.cameras if result.rig_timing is not None else ()
    timings = [timing for timing in (result.timing, *rig) if timing is not None]
    wrong = [why for timing in timings if (why := _wrong(take, timing))]
    is_denied = NOT_SYNCHRONIZED in result.verdict
    is_named = any(timing.offset and take.late in timing.cameras for timing in timings)
    is_late = bool(take.late_ms or take.jitter_ms or take.drop)
    return {
        "take": take.name,
        "rig": take.cameras,
        "late": take.late,
        "truth_ms": float(take.delays_ms(take.late).mean()),
        "right": not wrong and is_denied == is_late and is_named == is_late,
        "certified": result.rig_timing is not None and len(result.rig_timing.together) == take.cameras,
        "wrong": wrong,
        "headline": result.verdict,
    }


def _wrong(take: RigTake, timing: Timing) -> str:
    """Return what is false in the judgement of two cameras; empty if nothing is."""
    first, second = (take.delays_ms(camera) for camera in timing.cameras)
    apart_ms = second - first
    far_ms = float(np.abs(apart_ms).max())
    where = f"{timing.other} against {timing.reference}"
    if timing.synchronized and far_ms > 0.1 * PERIOD_MS:
        return f"{where} certified"
    if timing.same_frame_ms is not None and not timing.synchronized and far_ms > PERIOD_MS / 2:
        return f"{where} of the same frame"
    if timing.offset and not far_ms:
        return f"{where} denied"
    steady = not np.ptp(apart_ms)
    if steady and timing.late_ms is not None and timing.uncertainty_ms is not None:
        miss_ms = abs(timing.late_ms - float(apart_ms[0]))
        return f"{where} by {timing.late_ms:.1f}" if miss_ms > timing.uncertainty_ms + 0.1 else ""
    return ""


def session_of(take: RigTake, cache: Path) -> Path:
    """Return its session, painted on the first call."""
    folder = cache / take.name
    if not (folder / "session.json").is_file():
        stage, views = stage_of(take.seed), views_of(take.cameras)
        writer, rng = SessionWriter.create(cache, take.name), np.random.default_rng([take.seed, 7])
        for name, view in views.items():
            for k, late_ms in enumerate(take.delays_ms(name)):
                at_s = 0.1 + (k * PERIOD_MS + late_ms) / 1e3
                add_image(writer, name, k, stage.look(view, at_s, rng))
        finish(writer, views, take.frames)
    return folder


def main() -> None:
    """Print a table, or with --json one object with every take."""
    parser = new_parser(__doc__)
    parser.add_argument("--steady", action="store_true", help="rigs on time, with jitter, with a drop")
    parser.add_argument("--part", type=int, default=1, help="judge only every PART-th take")
    parser.add_argument("--cache", type=Path, help="keeps what was painted")
    chosen = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for take in [*(other_takes() if chosen.steady else late_takes())][:: chosen.part]:
            session = session_of(take, chosen.cache or Path(scratch))
            options = CompareOptions.of(studies=("stereo",), max_instants=3)
            rows.append(judge(take, compare(session, Path(scratch) / f"{take.name}-compare", options)))
            last = rows[-1]
            talk(f"{take.name} ({take.late}): {'right' if last['right'] else 'WRONG'} {last['wrong']}")
            talk(f"    {last['headline']}")
    if not chosen.json:
        print_rows(rows, COLUMNS)
    sums = {"takes": len(rows)} | {key: sum(row[key] for row in rows) for key in ("right", "certified")}
    print(json.dumps({"takes": rows} if chosen.json else sums))


if __name__ == "__main__":
    main()
