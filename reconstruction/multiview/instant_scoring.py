"""Scores of an instant's depth and cloud, on moving objects and on the control (static pixels)."""

from collections.abc import Mapping, Sequence

import numpy as np

from capture_app.common.errors import NotAvailableError
from reconstruction.common.geometry import Array
from reconstruction.multiview.cloud_accuracy import (
    TOLERANCE_M,
    PointIndex,
    TrueSurface,
    known_surfaces,
    points_on_masks,
    points_on_moving,
)
from reconstruction.multiview.instant_depth import InstantDepth
from reconstruction.multiview.undistorted_session import UndistortedSession
from reconstruction.scores.tally import Measurements, measure_depth
from reconstruction.scores.truth import fill_from_nearest, median_still_depth, true_depth_in_unit
from reconstruction.session.moving_pixels import dilate

CONTROL_MARGIN_PX = 4
"""Distance from a moving object below which pixels are left out of the control."""


class InstantScorer:
    """Scores instants of one reference camera; the still scene is taken from the synchronized maps."""

    def __init__(
        self,
        undistorted: UndistortedSession,
        reference: str,
        unit: str,
        instants: Sequence[int],
        synced: Sequence[InstantDepth],
    ) -> None:
        self.undistorted = undistorted
        self.reference = reference
        self.unit = unit
        self.cloud_skipped = ""
        self.tolerance_m: float | None = None
        moving = [undistorted.moving(reference, instant) for instant in instants]
        self._still = median_still_depth([one.depth for one in synced], moving)

    def measure(
        self, instant: int, shown: Mapping[str, int], maps: Mapping[str, InstantDepth]
    ) -> dict[str, Measurements]:
        """Measure moving objects and control by condition: `synced`, or `offset` with instants `shown`.

        Both conditions use the same control: pixels without a moving object in front in any image of either.
        """
        moving = self.undistorted.moving(self.reference, instant)
        hidden = {
            camera: self.undistorted.changing(camera, instant) | self.undistorted.changing(camera, other)
            for camera, other in shown.items()
        }
        static = self._still_control(instant, hidden)
        truth = self._true_depth(instant, static)
        surfaces = self._true_surfaces(instant, shown)
        measured = {name: Measurements() for name in maps}
        for name, found in maps.items():
            times = shown if name == "offset" else dict.fromkeys(shown, instant)
            clouds = self._measure_cloud(found, times, hidden, surfaces)
            for kind, mask in (("mover", moving), ("static", static)):
                one = measure_depth(found.depth, found.difference, mask, truth)
                one.shares["consistency"] = int((found.consistent & mask).sum()), int(mask.sum())
                one.update(clouds.get(kind, Measurements()))
                measured[name].update(one, f"{kind}_")
        return measured

    def true_depth(self, instant: int) -> Array | None:
        """Return the reference's true depth in the calibration's unit, NaN = unknown; None without truth."""
        return self._true_depth(instant, ~self.undistorted.moving(self.reference, instant))

    def _still_control(self, instant: int, hidden: Mapping[str, Array]) -> Array:
        changing = self.undistorted.motion.changing(self.reference, instant)
        here = dilate(self.undistorted.undistort_mask(self.reference, changing), CONTROL_MARGIN_PX)
        if not (self._still > 0).any():
            return ~here
        view = self.undistorted.views[self.reference]
        points = view.unproject(view.grid(), fill_from_nearest(self._still).ravel())
        others = {camera: mask for camera, mask in hidden.items() if camera != self.reference}
        hidden_here = points_on_masks(points, self.undistorted.views, others).reshape(here.shape)
        return np.asarray(~here & ~hidden_here)

    def _true_depth(self, instant: int, static: Array) -> Array | None:
        truth = self.undistorted.true_depth(self.reference, instant)
        return None if truth is None else true_depth_in_unit(truth, self.unit, self._still, static)

    def _true_surfaces(self, instant: int, shown: Mapping[str, int]) -> dict[str, TrueSurface] | None:
        """Return the true surfaces of an instant if the calibration is metric."""
        if self.unit != "m":
            return None
        full = {camera: self.undistorted.full_views[camera] for camera in shown}
        try:
            return known_surfaces(self.undistorted.dataset, full, instant)
        except NotAvailableError as error:
            self.cloud_skipped = str(error)
            return None

    def _measure_cloud(
        self,
        found: InstantDepth,
        times: Mapping[str, int],
        hidden: Mapping[str, Array],
        surfaces: dict[str, TrueSurface] | None,
    ) -> dict[str, Measurements]:
        """Measure the cloud's points, precision and recall on moving objects and on the still control."""
        self.cloud_skipped = self.cloud_skipped or str(found.no_cloud)
        if str(found.no_cloud):
            return {}
        views = {camera: self.undistorted.views[camera] for camera in times}
        moving_masks = {camera: self.undistorted.moving(camera, instant) for camera, instant in times.items()}
        moving = points_on_moving(found.points, found.seen, views, moving_masks)
        still = ~moving & ~points_on_masks(found.points, views, hidden)
        measured = {}
        for kind, mask, masks in (("mover", moving, {}), ("static", still, hidden)):
            points = found.points[mask]
            one = measured[kind] = Measurements(means={"points": np.array([float(len(points))])})
            if surfaces is None:
                continue
            index, shared = surfaces[kind]
            free = shared[~points_on_masks(shared, views, masks)]
            one.shares["precision"] = index.count_near(points)
            one.shares["recall"] = PointIndex(points).count_near(free)
            self.tolerance_m = TOLERANCE_M
        return measured
