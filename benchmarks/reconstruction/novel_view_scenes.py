"""Scenes as five cameras take them with the noise of a seed, and as seen from places without a camera."""

import functools
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import cv2
import numpy as np

from benchmarks.reconstruction import blank_scenes, thin_scenes
from benchmarks.report import talk
from capture_app.plugins.cameras.sim.rendering import scene as rendering
from capture_app.plugins.cameras.sim.scenes.stages import DEFINITIONS, SceneDefinition
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import BurstRecord, CameraRecord
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from reconstruction.common.geometry import Array, View
from reconstruction.reconstructed_session import open_session
from tests.facts import make_facts

SAMPLES = Path(__file__).parents[2] / "sample_sessions"
NOISE_MEANS = 12
"""Number of exposures whose mean is the true picture."""
EXPOSURE_NS, ROW_TIME_NS = 4_000_000, 12_300
JPEG_QUALITY = 90
THIN_PX = 3, 4
"""Thickness of the rods."""
Place = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Position of a camera and the point that it looks at, m."""
JUMPER: Mapping[str, Place] = {
    "between": ((0.0, -0.02, 0.0), (0.0, 0.13, 2.9)),
    "between right": ((0.17, -0.02, 0.01), (0.017, 0.13, 2.85)),
    "above": ((0.0, -0.16, 0.01), (0.0, 0.135, 2.85)),
    "above left": ((-0.15, -0.17, 0.015), (-0.01, 0.13, 2.8)),
    "beyond right": ((0.38, -0.05, 0.03), (0.03, 0.13, 2.8)),
    "beyond left": ((-0.38, -0.05, 0.03), (-0.03, 0.13, 2.8)),
}


class Shot(NamedTuple):
    """A moment of a scene, and the cameras that take it."""

    scene: str
    cameras: tuple[str, ...]
    at_ns: int


SHOTS = {
    "jumper": Shot("studio", ("cam00", "cam01", "cam04", "cam05", "cam06"), 0),
    "pinwheel": Shot("pinwheel", ("cam00", "cam01", "cam02", "cam03", "cam04"), 0),
    "blank room": Shot("blank-room", tuple(blank_scenes.ROOM_CAMERAS), 620_000_000),
    "blank attic": Shot("blank-attic", tuple(blank_scenes.ATTIC_CAMERAS), 400_000_000),
    "fine room": Shot("fine-room", tuple(blank_scenes.ROOM_CAMERAS), 400_000_000),
    **{f"rods {px}": Shot(f"rods-{px}", tuple(blank_scenes.ROOM_CAMERAS), 400_000_000) for px in THIN_PX},
}
SCENES: Mapping[str, SceneDefinition] = {
    **DEFINITIONS,
    "blank-room": blank_scenes.ROOM,
    "blank-attic": blank_scenes.ATTIC,
    "fine-room": thin_scenes.FINE_ROOM,
    **{f"rods-{px}": thin_scenes.rods(px) for px in (0, *THIN_PX)},
}


class Held(NamedTuple):
    """A held-out view, its true picture, where something moves (bool), and true depth, m."""

    view: View
    picture: Array
    moving: Array
    depth: Array
    without: Array | None = None
    """The true picture without rods, of a scene with rods."""


def places(shot: str) -> Mapping[str, Place]:
    """Return held-out places: two between cameras, two beyond and two above them."""
    if shot == "jumper":
        return JUMPER
    return dict(_around(list(SCENES[SHOTS[shot].scene].cameras.values())))


def _around(cameras: list[Place]) -> Iterator[tuple[str, Place]]:
    places = np.array(cameras)
    order = np.argsort(places[:, 0, 0])
    left, right, middle = places[order[0]], places[order[-1]], places.mean(axis=0)
    up = np.array([[0.0, -0.12, 0.0], [0.0, 0.0, 0.0]])
    found = {
        "between left": (left + middle) / 2,
        "between right": (right + middle) / 2,
        "beyond left": left + 0.2 * (left - right),
        "beyond right": right + 0.2 * (right - left),
        "above": middle + up,
        "above left": (left + middle) / 2 + up,
    }
    for name, (place, target) in found.items():
        yield name, (tuple(place.tolist()), tuple(target.tolist()))


def _start_ns(shot: str) -> int:
    """Return when a shot is exposed: the sample session's instant with most motion, if it is one."""
    if SHOTS[shot].at_ns:
        return SHOTS[shot].at_ns
    sample = open_session(SAMPLES / shot)
    start_ns = sample.frame(next(iter(sample.cameras)), 3).record.exposure_start_ns
    assert start_ns is not None
    return start_ns


@functools.cache
def _stage(scene: str) -> rendering.Scene:
    return rendering.Scene(scene, SCENES[scene])


def take(shot: str, seed: int, folder: Path) -> Session:
    """Write a session of one instant, with the noise of a seed and the true calibration."""
    scene, cameras, _ = SHOTS[shot]
    start_ns, stage = _start_ns(shot), _stage(scene)
    writer = SessionWriter.create(folder, f"{shot.replace(' ', '-')}-{seed}")
    for camera in cameras:
        picture = stage.render(camera, start_ns, EXPOSURE_NS, ROW_TIME_NS, seed=1000 + seed)
        data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
        writer.add_image(data, camera=camera, instant=0, leader_ns=start_ns, suffix=".jpg")
    lenses = stage.calibration().cameras
    writer.set_calibration(Calibration(cameras={name: lenses[name] for name in cameras}, source="simulated"))
    burst = BurstRecord(instants_ns=(start_ns,), period_ns=33_333_333)
    records = [CameraRecord(name=name, facts=make_facts()) for name in cameras]
    return writer.finish(records, burst, [], "simulated")


def true_views(shot: str, names: Collection[str] = ()) -> dict[str, Held]:
    """Render the held-out views of a shot: all, or those named."""
    held = {name: place for name, place in places(shot).items() if not names or name in names}
    shutter = _start_ns(shot), EXPOSURE_NS, ROW_TIME_NS
    found = render_places(SHOTS[shot].scene, held, shutter)
    if "rods" in shot:
        without = render_places("rods-0", held, shutter)
        found = {name: one._replace(without=without[name].picture) for name, one in found.items()}
    return found


def render_places(
    scene_name: str, held: Mapping[str, Place], shutter: tuple[int, int, int]
) -> dict[str, Held]:
    """Render a scene from places: start of the exposure, exposure and row time in ns."""
    scene = rendering.Scene(scene_name, replace(SCENES[scene_name], cameras=held))
    develop = rendering.develop

    def mean(light: Any, exposure_ns: int, rng: Any) -> Any:
        noisy = (develop(light, exposure_ns, np.random.default_rng(k)) for k in range(NOISE_MEANS))
        return np.rint(np.mean([one.astype(np.float32) for one in noisy], axis=0)).astype(np.uint8)

    found = {}
    for name in held:
        talk(f"rendering {name}")
        with patch.object(rendering, "develop", mean):
            picture = scene.render(name, *shutter, seed=1)
        depth, _, moving = scene.ground_truth(name, *shutter)
        camera = scene.views[name].calibration()
        found[name] = Held(View.from_calibration(camera, camera.width, camera.height), picture, moving, depth)
    return found
