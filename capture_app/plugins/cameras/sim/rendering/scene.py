"""Rendered scenes for simulated cameras: a frame is a pure function of view, times and seed."""

import copy
import functools
import threading

import numpy as np
from numpy.typing import NDArray

from capture_app.common.errors import BadInputError
from capture_app.plugins.cameras.sim.rendering.layers import (
    SUBPIXELS,
    MovingPart,
    StillLayer,
    View,
    cast_depth,
    find_visible,
    light_changes,
    look_at,
    moving_part,
    still_layer,
)
from capture_app.plugins.cameras.sim.rendering.lighting import sun_direction
from capture_app.plugins.cameras.sim.rendering.raycast import Body, Texture
from capture_app.plugins.cameras.sim.scenes import moving_bodies
from capture_app.plugins.cameras.sim.scenes.stages import DEFINITIONS, Floats, SceneDefinition
from capture_app.session.format.calibration import Calibration

SCENES = tuple(DEFINITIONS)

_STEPS = 8192
_WHITE = 6.0
"""Linear light at the end of the tone curve's table."""


class Scene:
    """A room with moving objects and its cameras; static layers are cached once rendered."""

    def __init__(
        self, name: str, definition: SceneDefinition, *, scale: float = 1.0, samples: int = 4
    ) -> None:
        self._definition = definition
        stage = definition.stage()
        textures = {name: Texture(picture) for name, picture in stage.pictures.items()}
        self.name = name
        self.things = (
            "nothing",
            *(f.thing for f in stage.fixtures),
            *sorted({part.thing for part in stage.parts.values()}),
        )
        """Names of the objects by their number in the ground truth's `objects`."""
        self._scale = scale
        self.views = self._views(scale)
        meshes = [(mesh, self.things.index(f.thing)) for f in stage.fixtures for mesh in f.meshes]
        self._room = Body([m for m, _ in meshes], textures, [thing for _, thing in meshes])
        self._bodies = {name: Body(part.meshes, textures) for name, part in stage.parts.items()}
        self._thing_of = {name: self.things.index(part.thing) for name, part in stage.parts.items()}
        self._still: dict[str, tuple[list[StillLayer], Floats]] = {}
        self._still_depth: dict[str, tuple[Floats, NDArray[np.uint8]]] = {}
        self._lock, self._drafting = threading.Lock(), threading.Lock()
        self._preparing: set[str] = set()
        self._samples = samples
        """Number of samples per pixel, repeated for long exposures."""

    def draft(self, scale: float) -> "Scene":
        """Return this scene with images of `scale` times the size and one sample per pixel: fast to render.

        It shares the static parts, and is cached for each scale, rounded to a percent.
        """
        with self._drafting:  # the cache alone would make two, and lose the layers of one
            return _draft(self, max(0.05, round(scale, 2)))

    def prepare(self, view: str) -> None:
        """Render the static parts of a view in the background, once, so that its first image comes sooner."""
        if view not in self._preparing:
            self._preparing.add(view)
            threading.Thread(target=self._layers, args=(self.views[view],), daemon=True).start()

    def render(
        self, view: str, start_ns: int, exposure_ns: int, row_time_ns: int, *, seed: int
    ) -> NDArray[np.uint8]:
        """Render a BGR uint8 image (H, W, 3); the exposure of row r starts at start_ns + r * row_time_ns.

        The same arguments give the same bytes, in any process of the same machine.
        """
        camera = self.views[view]
        layers, still_light = self._layers(camera)
        # The samples of a pixel are repeated for each 4 ms of exposure, up to 4 times.
        repeats = int(np.clip(-(-exposure_ns // 4_000_000), 1, 4)) if self._samples > 1 else 1
        light = still_light * repeats
        flat = light.reshape(-1, 3)
        count = repeats * len(layers)
        for number, layer in enumerate(layers * repeats):
            # Each at its own time, evenly distributed over the exposure.
            offset_ns = exposure_ns * (2 * number + 1) // (2 * count)
            parts = list(self._parts(camera, start_ns + offset_ns, row_time_ns).values())
            pixels, change = light_changes(camera, layer, parts, self._room, sun_direction(number, count))
            flat[pixels] += change
        rng = np.random.default_rng([seed % 2**64, start_ns % 2**64, list(self.views).index(view)])
        light /= count
        return develop(light, exposure_ns, rng)

    def ground_truth(
        self, view: str, start_ns: int, exposure_ns: int, row_time_ns: int
    ) -> tuple[Floats, NDArray[np.uint8], NDArray[np.bool_]]:
        """Return depth along the optical axis in m (0 = none), object numbers, moving pixels, each (H, W).

        They are exact at the pixels' centres and in the middle of each row's exposure.
        """
        camera = self.views[view]
        directions = camera.directions()
        with self._lock:
            if view not in self._still_depth:
                self._still_depth[view] = cast_depth(camera, self._room, directions)
            still_depth, still_things = self._still_depth[view]
        depth = np.where(still_depth > 0, still_depth, np.inf).astype(np.float32)
        things = still_things.copy()
        moving_mask = np.zeros(depth.shape, np.bool_)
        parts = self._parts(camera, start_ns + exposure_ns // 2, row_time_ns)
        numbers = {id(part): self._thing_of[name] for name, part in parts.items()}
        for seen in find_visible(camera, directions, depth, parts.values()):
            things.reshape(-1)[seen.pixels] = numbers[id(seen.part)]
            moving_mask.reshape(-1)[seen.pixels] = True
        depth[~np.isfinite(depth)] = 0
        return depth, things, moving_mask

    def calibration(self) -> Calibration:
        """Return true intrinsics and poses of all views, by name; the rig's frame is the scene's, in m."""
        return Calibration(
            cameras={name: view.calibration() for name, view in self.views.items()},
            source=f"the simulated scene {self.name}",
        )

    def _views(self, scale: float) -> dict[str, View]:
        return {
            name: look_at(name, place, target, scale=scale)
            for name, (place, target) in self._definition.cameras.items()
        }

    def _layers(self, view: View) -> tuple[list[StillLayer], Floats]:
        """Return the layers of a view, and their light together."""
        with self._lock:
            if view.name not in self._still:
                layers = [still_layer(view, self._room, number) for number in range(self._samples)]
                self._still[view.name] = layers, np.sum([x.from_sky + x.from_sun for x in layers], axis=0)
            return self._still[view.name]

    def _parts(self, view: View, first_row_ns: int, row_time_ns: int) -> dict[str, MovingPart]:
        times_ns = first_row_ns + row_time_ns * np.arange(view.height, dtype=np.int64)
        poses = self._definition.poses(moving_bodies.cycle_seconds(times_ns))
        return {name: moving_part(view, self._bodies[name], pose) for name, pose in poses.items()}


def load(name: str, *, scale: float = 1.0, samples: int = len(SUBPIXELS)) -> Scene:
    """Return the scene of that name, built once per process; `scale` shrinks its images from 640x480.

    `samples` is the number of samples per pixel, repeated for long exposures.

    Raises BadInputError for a scene that does not exist, NotAvailableError without Embree.
    """
    if name not in SCENES:
        raise BadInputError(f"there is no scene named {name!r}", hint=f"one of {', '.join(SCENES)}")
    return _built(name, scale, samples)


@functools.cache
def _draft(scene: Scene, scale: float) -> Scene:
    draft = copy.copy(scene)
    draft.views = draft._views(scene._scale * scale)
    draft._still, draft._still_depth = {}, {}
    draft._lock, draft._samples = threading.Lock(), 1
    return draft


@functools.cache
def _built(name: str, scale: float, samples: int) -> Scene:
    return Scene(name, DEFINITIONS[name], scale=scale, samples=samples)


@functools.cache
def _curve() -> NDArray[np.uint8]:
    """Return 8-bit values of linear light 0 to _WHITE: Narkowicz's fit of the ACES film curve, then sRGB."""
    light = np.linspace(0, _WHITE, _STEPS)
    tone = np.clip(light * (2.51 * light + 0.03) / (light * (2.43 * light + 0.59) + 0.14), 0, 1)
    srgb = np.where(tone <= 0.0031308, 12.92 * tone, 1.055 * tone ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * srgb), np.uint8)


@functools.cache
def _vignette(height: int, width: int) -> Floats:
    y, x = np.mgrid[:height, :width]
    distance = ((x - (width - 1) / 2) ** 2 + (y - (height - 1) / 2) ** 2) / (width**2 + height**2) * 4
    return np.asarray((1 - 0.26 * distance)[..., None], np.float32)


def develop(light: Floats, exposure_ns: int, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Convert linear light (H, W, 3) to a BGR uint8 image, as a sensor with automatic gain does.

    Shorter exposures need more gain and are noisier: photon noise grows with the square root of the light.
    """
    seen = light * _vignette(*light.shape[:2])
    gain = float(np.clip(np.sqrt(8e6 / max(exposure_ns, 1)), 0.5, 2.5))
    deviation = gain * np.sqrt(0.00012 * np.maximum(seen, 0.0) + 0.000006)
    seen += deviation * rng.standard_normal(seen.shape, dtype=np.float32)
    return np.asarray(_curve()[np.clip(seen * ((_STEPS - 1) / _WHITE), 0, _STEPS - 1).astype(np.int32)])
