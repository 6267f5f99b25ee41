"""Image sources of a simulated camera: a rendered scene, a plugin's view, or a test card."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from capture_app.common.errors import BadInputError
from capture_app.common.plugins import load_plugin, plugin_names
from capture_app.plugins.cameras.sim.sensor import SensorFrame
from capture_app.session.format.calibration import CameraCalibration

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from capture_app.plugins.cameras.sim.rendering.scene import Scene

    GroundTruthArrays = tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.bool_]]

TEST_CARD = "bars"
VIEWS = "simulshot.simulated_views"
"""Group of entry points: modules that render a view, with its `WIDTH`, `HEIGHT` (pixels) and `render`."""


@dataclass(frozen=True, slots=True)
class PictureSource(ABC):
    """Renders one camera's frames, flat by default; each is a pure function of frame and seed."""

    width: int
    """Width of the images in pixels, as is `height`."""
    height: int

    @property
    def calibration(self) -> CameraCalibration | None:
        """Intrinsics and pose of the camera's view; None if the images show nothing measurable."""
        return None

    @abstractmethod
    def render(self, frame: SensorFrame, *, seed: int) -> NDArray[np.uint8]:
        """Return the image, BGR uint8 (height, width, 3)."""

    def reduced(self, frame: SensorFrame, width: int, *, seed: int) -> NDArray[np.uint8]:
        """Return the image, BGR uint8, about `width` pixels wide if that is faster to render."""
        return self.render(frame, seed=seed)

    def ground_truth(self, frame: SensorFrame) -> GroundTruthArrays:
        """Return depth in m (0 = none), object numbers and moving pixels, each (height, width)."""
        import numpy as np

        shape = (self.height, self.width)
        return np.zeros(shape, np.float32), np.zeros(shape, np.uint8), np.zeros(shape, np.bool_)


@dataclass(frozen=True, slots=True)
class ColourBars(PictureSource):
    """Colour bars with the camera's name, the frame's number and time, and a hand with a period of 1 s."""

    camera: str

    def reduced(self, frame: SensorFrame, width: int, *, seed: int) -> NDArray[np.uint8]:
        """Return the card, BGR uint8, at that width, or at its own width if that is smaller."""
        width = min(width, self.width)
        return ColourBars(width, max(1, self.height * width // self.width), self.camera).render(
            frame, seed=seed
        )

    def render(self, frame: SensorFrame, *, seed: int) -> NDArray[np.uint8]:
        """Return the card, BGR uint8 (height, width, 3); `seed` changes its faint grain."""
        import cv2
        import numpy as np

        bars = np.array([(b, g, r) for g in (200, 40) for r in (200, 40) for b in (200, 40)], dtype=np.uint8)
        row = bars[np.arange(self.width) * len(bars) // self.width]
        image = np.repeat(row[np.newaxis], self.height, axis=0)
        image[self.height * 2 // 3 :] = np.linspace(16, 235, self.width).astype(np.uint8)[:, np.newaxis]
        grain = np.random.default_rng(seed).integers(0, 4, size=(self.height, self.width, 1), dtype=np.uint8)
        image = np.add(image, grain, dtype=np.uint8)

        unit = self.height / 480
        centre = (self.width // 2, self.height // 3)
        radius = round(110 * unit)
        hand_angle = (frame.start_true_ns + frame.exposure_ns // 2) % 10**9 / 1e9 * 2 * np.pi
        tip = (round(centre[0] + radius * np.sin(hand_angle)), round(centre[1] - radius * np.cos(hand_angle)))
        thick = max(1, round(6 * unit))
        cv2.circle(image, centre, round(radius * 1.15), (24, 24, 24), -1, cv2.LINE_AA)
        cv2.circle(image, centre, round(radius * 1.15), (245, 245, 245), max(1, thick // 2), cv2.LINE_AA)
        cv2.line(image, centre, tip, (60, 200, 255), thick, cv2.LINE_AA)
        lines = (
            (self.camera, 1.4),
            (f"frame {frame.sequence} of stream {frame.stream}", 0.8),
            (f"true time {frame.start_true_ns / 1e9:.6f} s", 0.8),
        )
        for number, (text, size) in enumerate(lines, 1):
            at = (round(24 * unit), round(self.height * 2 / 3 + 45 * unit * number))
            for colour, width in (((0, 0, 0), thick), ((255, 255, 255), max(1, thick // 3))):
                cv2.putText(
                    image, text, at, cv2.FONT_HERSHEY_SIMPLEX, size * unit, colour, width, cv2.LINE_AA
                )
        return image


@dataclass(frozen=True, slots=True)
class SceneView(PictureSource):
    """One view of a rendered scene, read out row by row."""

    scene: Scene
    view: str
    row_time_ns: int

    @property
    def calibration(self) -> CameraCalibration | None:
        """Intrinsics and pose of the view."""
        return self.scene.calibration().cameras[self.view]

    def render(self, frame: SensorFrame, *, seed: int) -> NDArray[np.uint8]:
        """Return the rendered view, BGR uint8 (height, width, 3)."""
        return self.scene.render(
            self.view, frame.start_true_ns, frame.exposure_ns, self.row_time_ns, seed=seed
        )

    def reduced(self, frame: SensorFrame, width: int, *, seed: int) -> NDArray[np.uint8]:
        """Return the view at about that width, BGR uint8, with one sample per pixel and no motion blur."""
        draft = self.scene.draft(min(1.0, width / self.width))
        row_time_ns = self.row_time_ns * self.height // draft.views[self.view].height
        image = draft.render(self.view, frame.start_true_ns, frame.exposure_ns, row_time_ns, seed=seed)
        self.scene.prepare(self.view)  # a viewer takes a picture soon
        return image

    def ground_truth(self, frame: SensorFrame) -> GroundTruthArrays:
        """Return the view's true depth in m, object numbers and moving pixels."""
        return self.scene.ground_truth(self.view, frame.start_true_ns, frame.exposure_ns, self.row_time_ns)


@dataclass(frozen=True, slots=True)
class PluginView(PictureSource):
    """A view of one size that a plugin renders, read out row by row."""

    row_time_ns: int
    plugin: Any

    def render(self, frame: SensorFrame, *, seed: int) -> NDArray[np.uint8]:
        """Return the image, BGR uint8 (height, width, 3)."""
        import numpy as np

        rng = np.random.default_rng([seed % 2**64, frame.start_true_ns % 2**64])
        image: NDArray[np.uint8] = self.plugin.render(
            frame.start_true_ns, exposure_ns=frame.exposure_ns, row_time_ns=self.row_time_ns, rng=rng
        )
        return image


def open_picture_source(
    scene: str,
    view: str,
    *,
    camera: str,
    width: int,
    height: int,
    row_time_ns: int,
    scale: float = 1.0,
    samples: int = 4,
) -> PictureSource:
    """Open the test card of that size (`bars`), a plugin's view (`led-panel`), or a view of a rendered scene.

    Plugins and scenes have their own size. `scale` shrinks the card and scenes; a scene casts `samples`
    rays per pixel. An empty `view` selects the one named like the camera. Raises BadInputError for a scene
    or view that does not exist and NotAvailableError if this machine cannot render scenes.
    """
    is_plugin = scene in plugin_names(VIEWS)
    if view and (is_plugin or scene == TEST_CARD):
        raise BadInputError(f"{scene!r} has no view {view!r}", hint="leave view= out")
    if scene == TEST_CARD:
        return ColourBars(round(width * scale), round(height * scale), camera)
    if is_plugin:
        if scale != 1:
            raise BadInputError(f"{scene!r} has one size", hint="leave scale= out")
        plugin = load_plugin(VIEWS, scene, "WIDTH", "HEIGHT", "render")
        return PluginView(plugin.WIDTH, plugin.HEIGHT, row_time_ns, plugin)
    from capture_app.plugins.cameras.sim.rendering.scene import load

    loaded = load(scene, scale=scale, samples=samples)
    view = view or camera
    if view not in loaded.views:
        raise BadInputError(
            f"scene {scene!r} has no view {view!r}", hint=f"view= one of {', '.join(loaded.views)}"
        )
    calibration = loaded.calibration().cameras[view]
    return SceneView(calibration.width, calibration.height, loaded, view, row_time_ns)
