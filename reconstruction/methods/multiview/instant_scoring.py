"""Scores of an instant's depth and cloud, on moving objects and on the control (static pixels)."""

import ctypes
import math
from collections.abc import Mapping, Sequence

import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.depth.kernels import call_kernel, floats
from reconstruction.method.tally import Measurements, measure_depth
from reconstruction.method.truth import fill_from_nearest, median_still_depth, true_depth_in_unit
from reconstruction.methods.multiview.fusion import FusedCloud, project_points, surface_points
from reconstruction.methods.multiview.input_images import InputImage, InputImages, undistorted_truth
from reconstruction.methods.multiview.instant_depth import InstantDepth, confirm
from reconstruction.methods.multiview.result import CloudScore
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.moving_pixels import dilate

TOLERANCE_M = 0.01
"""Distance within which a point is right, and a true surface is found."""
MAX_SAMPLED = 20_000
"""Size of the random sample of larger point sets."""
VISIBLE_FRACTION = 0.01
"""Relative depth error below which a view sees a point, i.e. it is not occluded."""


def count_near(points: Array, asked: Array) -> tuple[int, int]:
    """Return how many of the `asked` points have one of the points (n, 3; m) within the tolerance.

    The second number is that of the points asked, a sample of `MAX_SAMPLED` if there are more.
    """
    asked = floats(_sample(asked))
    near = np.empty(len(asked), bool)
    sizes = ctypes.c_int64(len(points)), ctypes.c_int64(len(asked))
    call_kernel("near", sizes[0], floats(points), sizes[1], asked, ctypes.c_float(TOLERANCE_M), near)
    return int(near.sum()), len(asked)


TrueSurface = tuple[Array, Array]
"""All points (n, 3) that any view sees, and evenly spaced points (m, 3) that at least two views see.

A reconstruction can find only the latter.
"""


def known_surfaces(
    dataset: Dataset, views: Mapping[str, View], instant: int, kinds: Sequence[str] = ("mover", "static")
) -> dict[str, TrueSurface] | None:
    """Return the true surfaces of an instant, see `true_surfaces`; None if a camera's truth is unknown.

    `views` have the distortion of the session's images.
    """
    loaded = {camera: undistorted_truth(dataset, view, camera, instant) for camera, view in views.items()}
    known = {camera: image for camera, image in loaded.items() if image is not None}
    if len(known) < len(loaded):
        return None
    plain = {camera: view.undistorted for camera, view in views.items()}
    depth, moving_masks = ({camera: image[which] for camera, image in known.items()} for which in (0, 1))
    return true_surfaces(plain, depth, moving_masks, kinds)


def true_surfaces(
    views: Mapping[str, View],
    depth: Mapping[str, Array],
    moving_masks: Mapping[str, Array],
    kinds: Sequence[str],
) -> dict[str, TrueSurface]:
    """Return the moving (`mover`) and still (`static`) surfaces from undistorted true depth and masks (bool).

    Only the `kinds` asked for: each takes a second for five VGA cameras.
    """
    parts: dict[str, list[Array]] = {"mover": [], "static": []}
    for name, view in views.items():
        step = max(1, round(view.width / 960))
        rows, columns = (axis[::step, ::step].ravel() for axis in np.mgrid[0 : view.height, 0 : view.width])
        z, moving = depth[name][rows, columns], moving_masks[name][rows, columns]
        points = surface_points(view, rows, columns, z)
        parts["mover"].append(points[(z > 0) & moving])
        parts["static"].append(points[(z > 0) & ~moving])
    by_camera = {}
    for kind in kinds:
        points = np.concatenate(parts[kind])
        asked = _sample(_thin_out(points))
        seen = sum(visible_points(view, depth[name], asked).astype(int) for name, view in views.items())
        by_camera[kind] = points, asked[np.asarray(seen) >= 2]
    return by_camera


def points_on_moving(
    points: Array, seen: Array, views: Mapping[str, View], moving_masks: Mapping[str, Array]
) -> Array:
    """Return the points (bool) that are on a moving object in most of the images they were fused from.

    `seen` (n, views) is bool, in the order of the views. `moving_masks`: each view's motion mask (bool).
    """
    votes = np.zeros(len(points), int)
    for place, (name, view) in enumerate(views.items()):
        votes += seen[:, place] & _on_mask(view, moving_masks[name], points)
    return np.asarray(2 * votes > seen.sum(1))


def points_on_masks(points: Array, views: Mapping[str, View], masks: Mapping[str, Array]) -> Array:
    """Return the points (bool) that any view sees on its mask (bool)."""
    touched = np.zeros(len(points), bool)
    for name, mask in masks.items():
        touched |= _on_mask(views[name], mask, points)
    return touched


def visible_points(view: View, depth: Array, points: Array) -> Array:
    """Return the points (bool) that a view sees, by its true depth; they are not occluded."""
    at, z, inside = project_points(view, points)
    return np.asarray(inside & (np.abs(depth.take(at) - z) < VISIBLE_FRACTION * z))


def _on_mask(view: View, mask: Array, points: Array) -> Array:
    at, _, inside = project_points(view, points)
    return np.asarray(inside & mask.take(at))


def _sample(points: Array) -> Array:
    """Return at most `MAX_SAMPLED` of the points, always the same ones."""
    if len(points) <= MAX_SAMPLED:
        return points
    return np.asarray(points[np.random.default_rng(0).choice(len(points), MAX_SAMPLED, replace=False)])


def _thin_out(points: Array) -> Array:
    """Return one point for each cube with a side of one tolerance."""
    if not len(points):
        return points
    cubes = np.floor((points - points.min(0)) / TOLERANCE_M).astype(np.int64)
    # A million cubes along each axis, ten kilometres, suffice for any scene.
    keys = (cubes[:, 0] << 40) | (cubes[:, 1] << 20) | cubes[:, 2]
    # Neighbouring pixels often share a cube, and need no sorting.
    firsts = np.flatnonzero(np.diff(keys, prepend=keys[0] - 1))
    return np.asarray(points[firsts[np.unique(keys[firsts], return_index=True)[1]]])


def score_moving(
    dataset: Dataset, images: Mapping[str, InputImage], unit: str, instant: int, cloud: FusedCloud
) -> CloudScore | None:
    """Score the moving points of a fused cloud against the true surfaces of an instant.

    `images` are the images it was fused from, in order; some may be of other instants. None if the truth is
    unknown, the calibration (in `unit`) is not metric, or nothing moves.
    """
    if unit != "m":
        return None
    shown = {c: undistorted_truth(dataset, image.view, c, image.instant) for c, image in images.items()}
    moving_masks = {camera: one[1] for camera, one in shown.items() if one is not None}
    known = known_surfaces(dataset, {c: image.view for c, image in images.items()}, instant, ["mover"])
    if known is None or len(moving_masks) < len(images):
        return None
    true, shared = known["mover"]
    views = {camera: image.calibrated.view for camera, image in images.items()}
    points = cloud.points[points_on_moving(cloud.points, cloud.seen, views, moving_masks)]
    measured_cloud = Measurements(
        {"precision": count_near(true, points), "recall": count_near(points, shared)}
    )
    precision, recall, f_score = (measured_cloud.value(name) for name in ("precision", "recall", "f_score"))
    if math.isnan(recall):
        return None
    return CloudScore(
        points=len(points),
        precision=None if math.isnan(precision) else round(precision, 4),
        recall=round(recall, 4),
        f_score=round(f_score, 4),
    )


class InstantScorer:
    """Scores instants of one reference camera; the still scene is taken from the synchronized maps."""

    def __init__(
        self,
        undistorted: InputImages,
        reference: str,
        unit: str,
        instants: Sequence[int],
        synced: Sequence[InstantDepth],
    ) -> None:
        """`synced` is the depth of synchronized images at these instants, with the reference's."""
        self.undistorted = undistorted
        self.reference = reference
        self.unit = unit
        self.tolerance_m: float | None = None
        moving = [undistorted.moving(reference, instant) for instant in instants]
        self._still = median_still_depth([maps.maps[reference].depth for maps in synced], moving)

    def measure(
        self, instant: int, shown: Mapping[str, int], maps: Mapping[str, InstantDepth]
    ) -> dict[str, Measurements]:
        """Return the accuracy of depth and cloud, on moving objects and on the control, by condition.

        `shown` is each camera's instant in condition `offset`; in `synced` all show `instant`.
        Both use the same control: pixels without a moving object in front in any image of either.
        """
        moving = self.undistorted.moving(self.reference, instant)
        hidden = {
            camera: self.undistorted.changing(camera, instant) | self.undistorted.changing(camera, other)
            for camera, other in shown.items()
        }
        static = self._still_control(instant, hidden)
        truth = self._true_depth(instant, static)
        full = {camera: self.undistorted.scene.views[camera] for camera in shown}
        surfaces = known_surfaces(self.undistorted.dataset, full, instant) if self.unit == "m" else None
        measured = {name: Measurements() for name in maps}
        for name, found in maps.items():
            times = shown if name == "offset" else dict.fromkeys(shown, instant)
            clouds = self._measure_cloud(found, times, hidden, surfaces)
            images = {c: self.undistorted.image(c, times[c]).calibrated for c in found.maps}
            confirmed, difference = confirm(self.reference, images, found.maps)
            for kind, mask in (("mover", moving), ("static", static)):
                scored = measure_depth(found.maps[self.reference].depth, difference, mask, truth)
                scored.shares["consistency"] = int((confirmed & mask).sum()), int(mask.sum())
                scored.update(clouds.get(kind, Measurements()))
                measured[name].update(scored, f"{kind}_")
        return measured

    def true_depth(self, instant: int) -> Array | None:
        """Return the reference's true depth in the calibration's unit, NaN = unknown; None without truth."""
        return self._true_depth(instant, ~self.undistorted.moving(self.reference, instant))

    def _still_control(self, instant: int, hidden: Mapping[str, Array]) -> Array:
        session = self.undistorted
        changing = session.undistort_mask(self.reference, session.motion.changing(self.reference, instant))
        here = dilate(changing, 4)
        if not (self._still > 0).any():
            return ~here
        view = self.undistorted.plain_views[self.reference]
        points = view.unproject(view.grid(), fill_from_nearest(self._still).ravel())
        others = {camera: mask for camera, mask in hidden.items() if camera != self.reference}
        hidden_here = points_on_masks(points, self.undistorted.plain_views, others).reshape(here.shape)
        return np.asarray(~here & ~hidden_here)

    def _true_depth(self, instant: int, static: Array) -> Array | None:
        truth = self.undistorted.true_depth(self.reference, instant)
        return None if truth is None else true_depth_in_unit(truth, self.unit, self._still, static)

    def _measure_cloud(
        self,
        found: InstantDepth,
        times: Mapping[str, int],
        hidden: Mapping[str, Array],
        surfaces: dict[str, TrueSurface] | None,
    ) -> dict[str, Measurements]:
        """Measure the cloud's points, precision and recall on moving objects and on the still control."""
        cloud, views = found.cloud.points, {c: self.undistorted.plain_views[c] for c in found.maps}
        moving_masks = {camera: self.undistorted.moving(camera, times[camera]) for camera in views}
        seen = np.column_stack([visible_points(views[c], one.depth, cloud) for c, one in found.maps.items()])
        moving = points_on_moving(cloud, seen, views, moving_masks)
        still = ~moving & ~points_on_masks(cloud, self.undistorted.plain_views, hidden)
        measured = {}
        for kind, mask, masks in (("mover", moving, {}), ("static", still, hidden)):
            points = cloud[mask]
            one = measured[kind] = Measurements(means={"points": np.array([float(len(points))])})
            if surfaces is None:
                continue
            true, shared = surfaces[kind]
            free = shared[~points_on_masks(shared, self.undistorted.plain_views, masks)]
            one.shares["precision"] = count_near(true, points)
            one.shares["recall"] = count_near(points, free)
            self.tolerance_m = TOLERANCE_M
        return measured
