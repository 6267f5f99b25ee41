"""A moving board before cameras that know nothing of each other: own start, own rate, own gaps."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from capture_app.session.format.calibration import Calibration
from capture_app.session.format.common_times import CommonTimes
from capture_app.session.format.manifest import BurstRecord, CameraRecord, MissingImage
from capture_app.session.importing.frame_matching import TimedFrame, timeline_by_times
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from reconstruction.common.geometry import View
from tests.facts import make_facts
from tests.unit.reconstruction.conftest import HEIGHT, PERIOD_NS, WIDTH, Scene


@dataclass(frozen=True)
class Recorder:
    """A camera that starts at a true time and whose clock runs `ppm` too fast."""

    view: View
    start_s: float = 0.0
    fps: float = 30.0
    ppm: float = 0.0
    jitter_s: float = 0.0

    def own_s(self, true_s: float) -> float:
        """Its own time of a true one."""
        return (true_s - self.start_s) * (1 + self.ppm * 1e-6)

    def true_s(self, own_s: float) -> float:
        """The true time of one of its own."""
        return self.start_s + own_s / (1 + self.ppm * 1e-6)


def wander(periods: float) -> tuple[float, float]:
    """Here and there, faster and slower, never the same again."""
    t = periods
    return (
        0.3 * np.sin(0.13 * t) + 0.14 * np.sin(0.37 * t + 1) + 0.05 * np.sin(0.71 * t + 2),
        0.25 * np.sin(0.11 * t + 2) + 0.12 * np.sin(0.31 * t) + 0.05 * np.sin(0.83 * t + 1),
    )


def rest(_: float) -> tuple[float, float]:
    """Nowhere."""
    return 0.0, 0.0


def write_cut_apart(
    root: Path,
    scene: Scene,
    cameras: Mapping[str, Recorder],
    seconds: float,
    *,
    seed: int = 0,
    path: Callable[[float], tuple[float, float]] = wander,
) -> Session:
    """An imported session whose images are paired by each camera's own times, which say nothing.

    The last board moves along `path`, by the time in periods.
    """
    boards = [*scene.boards[:-1], replace(scene.boards[-1], path=path)]
    moving = replace(scene, boards=boards)
    rng = np.random.default_rng(seed)
    frames = {}
    for name, camera in cameras.items():
        count = int(seconds * camera.fps)
        own_s = np.arange(count) / camera.fps + rng.uniform(0, 1, count) * camera.jitter_s
        frames[name] = [TimedFrame(k, round(at * 1e9), round(at * 1e9)) for k, at in enumerate(own_s)]
    timeline = timeline_by_times("the test", frames)
    writer = SessionWriter.create(root, "apart")
    missing = []
    for number, instant in enumerate(timeline.instants):
        for name, camera in cameras.items():
            frame = instant.frames.get(name)
            if frame is None:
                missing.append(MissingImage(camera=name, instant=number, reason="none"))
                continue
            periods = camera.true_s(frame.leader_ns / 1e9) * 1e9 / PERIOD_NS
            image, _, _ = moving.look(camera.view, periods)
            writer.add_image(
                cv2.imencode(".png", image)[1].tobytes(),
                camera=name,
                instant=number,
                leader_ns=frame.leader_ns,
                local_ns=frame.local_ns,
                residual_ns=frame.leader_ns - instant.leader_ns,
                suffix=".png",
                sequence=frame.index,
            )
    writer.set_calibration(
        Calibration(cameras={n: c.view.to_calibration() for n, c in cameras.items()}, source="boards")
    )
    facts = make_facts(width=WIDTH, height=HEIGHT, period_ns=timeline.period_ns)
    burst = BurstRecord(
        instants_ns=tuple(instant.leader_ns for instant in timeline.instants),
        period_ns=timeline.period_ns,
        common_times=CommonTimes(state="unknown", reason="each video counts from its own beginning"),
    )
    records = [CameraRecord(name=name, facts=facts) for name in cameras]
    return writer.finish(records, burst, missing, origin="imported")
