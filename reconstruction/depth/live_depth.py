"""Depth of one camera while the scene moves: one sweep of small images an instant, checked by all sources."""

from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np

from capture_app.common import system
from capture_app.common.errors import BadInputError, NotApplicableError
from reconstruction.common.geometry import Array, View, resize_view
from reconstruction.depth.calibrated_image import CalibratedImage, SourceView, matching_noise
from reconstruction.depth.geometric_consistency import MAX_COST, MIN_ISLAND_PX, remove_speckles
from reconstruction.depth.plane_sweep import PlaneSweep, Refinement, smoothed_costs_along
from reconstruction.depth.rough_scene import RoughScene, find_rough_scene, point_range
from reconstruction.depth.sweep_kernels import WORST_COST, warp
from reconstruction.depth.view_choice import choose_source_views

SWEEP = PlaneSweep(refinements=(Refinement(0.2, 3),), max_cells=2_500_000)
MAX_SOURCES = 3
LOOK_S = 5.0
"""Interval between two searches for the scene's depth range, in seconds; each takes half a second."""
MIN_CHANGE, NOISE_CHANGE = 10.0, 2.0
"""Minimum change of a moving pixel: in grey levels (of 255), and in multiples of the noise's 3 sigma."""
MIN_MOVING_PX = 100


@dataclass(frozen=True, eq=False)
class LiveMap:
    """Depth on the reference's undistorted pixels, at the small size (height x width)."""

    depth: Array
    """Along the axis, float32, in the calibration's unit; 0 where the other cameras do not confirm it."""
    depth_range: tuple[float, float]
    """Nearest and farthest depth of points that cameras confirm."""
    moving: Array
    """Pixels (bool) that differ from the two images before."""
    moving_confirmed: float | None
    """Fraction of moving pixels, of those with detail that others see, with depth; None if few move."""


class LiveDepth:
    """Depth of one camera of a calibrated rig, from small images of one instant after the other."""

    def __init__(self, views: Mapping[str, View], width_px: int = 320) -> None:
        """`views`: the cameras' calibrated views; `width_px`: width at which they are matched."""
        self.views = {
            name: resize_view(view, width_px, round(view.height * width_px / view.width))
            for name, view in views.items()
        }
        self._maps = {
            name: cv2.convertMaps(*view.lens.maps((view.width, view.height), view.matrix), cv2.CV_16SC2)
            for name, view in self.views.items()
            if not view.lens.is_straight
        }
        self._noise: dict[str, float] = {}
        """Each camera's noise, measured when the scene is searched."""
        self._before: deque[dict[str, Array]] = deque(maxlen=2)
        """Grey images of the instants before."""
        self._pool = ThreadPoolExecutor(1)
        self._looking: Future[RoughScene] | None = None
        self._due_s = 0.0
        self._scene: RoughScene | None = None
        self._sources: dict[str, tuple[str, ...]] = {}

    def compute(self, images: Mapping[str, Array], camera: str) -> LiveMap:
        """Return a camera's depth from all cameras' images of one instant (BGR uint8 height x width x 3).

        Raises:
            BadInputError: that camera is not calibrated, or has no image.
            NotApplicableError: no other camera has an image, or sees what this one sees.
        """
        for names, problem in ((self.views, "is not in the calibration"), (images, "gives no picture")):
            if camera not in names:
                raise BadInputError(f"{camera} {problem}", hint="choose another camera")
        calibrated = {
            name: self._calibrate(name, image) for name, image in images.items() if name in self.views
        }
        if len(calibrated) < 2:
            raise NotApplicableError(
                f"no camera beside {camera} gives a picture", hint="see their states: capture-app status"
            )
        scene = self._look(calibrated)
        sources = [calibrated[o] for o in self._sources.get(camera, ()) if o in calibrated][:MAX_SOURCES]
        if not sources:
            raise NotApplicableError(f"no other camera sees what {camera} sees", hint="choose another camera")
        reference = calibrated[camera]
        surface = SWEEP.sweep(reference, sources, scene.depth_ranges[camera])
        confirmed, seen = self._confirm(reference, sources, surface.inverse_depth)
        moving = self._moving(camera, reference)
        self._before.append({name: image.grey for name, image in calibrated.items()})
        judged = moving & seen & ~reference.flat
        return LiveMap(
            surface.depth_where(confirmed),
            point_range(reference.view, scene.points[camera]),
            moving,
            float(confirmed[judged].mean()) if judged.sum() >= MIN_MOVING_PX else None,
        )

    def _calibrate(self, name: str, image: Array) -> CalibratedImage:
        view = self.views[name]
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        if grey.shape != (view.height, view.width):
            grey = cv2.resize(grey, (view.width, view.height), interpolation=cv2.INTER_AREA)
        if name in self._maps:
            grey = cv2.remap(grey, *self._maps[name], cv2.INTER_LINEAR)
        if name not in self._noise:
            self._noise[name] = matching_noise(grey)
        return CalibratedImage(view.undistorted, grey.astype(np.float32), SWEEP.window, self._noise[name])

    def _look(self, images: Mapping[str, CalibratedImage]) -> RoughScene:
        """Return where the scene is; search it again in the background, as what moves may come nearer."""
        if self._looking is None and (self._scene is None or system.monotonic_s() > self._due_s):
            self._looking = self._pool.submit(find_rough_scene, images)
            self._due_s = system.monotonic_s() + LOOK_S
            self._noise.clear()
        if self._looking is not None and (self._scene is None or self._looking.done()):
            looking, self._looking = self._looking, None
            if self._scene is None or looking.exception() is None:
                self._scene = looking.result()
                views = {name: images[name].view for name in self._scene.points if name in images}
                self._sources = choose_source_views(views, self._scene.points)
        assert self._scene is not None, "it was found, or the search has raised"
        return self._scene

    def _confirm(
        self, reference: CalibratedImage, sources: list[CalibratedImage], inverse_depth: Array
    ) -> tuple[Array, Array]:
        """Return where all sources but one match at these depths, and where enough of them see it (bool)."""
        fine = replace(reference, window=SWEEP.fine_window)
        pairs = [SourceView(fine, source) for source in sources]
        able, same = (np.zeros(inverse_depth.shape, np.uint8) for _ in range(2))
        for pair in pairs:
            able += warp(pair, inverse_depth) >= 0
            same += smoothed_costs_along(inverse_depth, [pair]) < MAX_COST * WORST_COST
        enough = min(2, len(sources))
        confirmed = same >= np.maximum(able, enough + 1) - 1 if enough > 1 else same >= 1
        return remove_speckles(confirmed, inverse_depth, MIN_ISLAND_PX), able >= enough

    def _moving(self, camera: str, reference: CalibratedImage) -> Array:
        """Return the pixels that differ from both images before; uncovered ones look as they did earlier."""
        limit = max(MIN_CHANGE, NOISE_CHANGE * float(np.sqrt(reference.noise)))
        before = [greys[camera] for greys in self._before if camera in greys]
        moving = np.full(reference.grey.shape, len(before) == 2)
        for grey in before:
            change = reference.grey - grey
            moving &= np.abs(change - np.median(change[::4, ::4])) > limit
        return np.asarray(cv2.medianBlur(moving.astype(np.uint8), 5) > 0)
