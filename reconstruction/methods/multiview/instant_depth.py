"""Depth of one camera from several at one instant, and the cloud fused from all their depth maps."""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.common.image_matching import match_brightness
from reconstruction.depth.calibrated_image import SourceView
from reconstruction.depth.geometric_consistency import count_coinciding_views
from reconstruction.depth.plane_sweep import Surface
from reconstruction.depth.sweep_engine import CPU
from reconstruction.depth.view_choice import smallest_group
from reconstruction.methods.multiview.blank_walls import ScenePlane
from reconstruction.methods.multiview.fusion import fuse_maps, median_of_known
from reconstruction.methods.multiview.input_images import InputImage
from reconstruction.methods.multiview.matcher import ChosenMatcher, image_colours, image_views, match_cameras
from reconstruction.methods.multiview.still_scene import StillScene
from reconstruction.methods.multiview.sweep_matcher import ViewDepth

SWEEP = ChosenMatcher()
NO_PLANES: Array = np.zeros((0, 4))
CONFIRMING_VIEWS = 2
"""Number of other views that must find a depth for it to be called consistent."""


@dataclass(frozen=True, eq=False)
class InstantDepth:
    """Maps on the reference's undistorted pixels (height x width), and a cloud in the rig's frame.

    `depth` is 0 where unknown. `consistent` (bool) marks pixels where two other views, each matched
    independently, found the same depth, before any other check. `difference` is in grey levels between the
    reference and its sources, warped by all matched depth: the median over the sources, NaN = none sees it.
    `points` (n, 3) are float32 with `colours` (n, 3), uint8 RGB. `seen` (n, cameras), bool, marks the maps
    that each point was fused from, in the order of the images. `planes` (n, 4) are normal and distance of the
    planes on which blank walls may be. `all_depth` and `all_normals` are the maps of all cameras, flat, one
    after the other in the order of the images; empty if they were not kept.
    """

    depth: Array
    consistent: Array
    difference: Array
    points: Array
    colours: Array
    seen: Array
    planes: Array
    all_depth: Array = field(default_factory=lambda: np.zeros(0))
    all_normals: Array = field(default_factory=lambda: np.zeros(0))

    def all_maps(self, views: Mapping[str, View]) -> dict[str, ViewDepth]:
        """Return the maps of all cameras, whose views are in the order of the images."""
        ends = np.cumsum([view.width * view.height for view in views.values()])
        if not len(ends) or len(self.all_depth) != ends[-1]:
            return {}
        depths, normals = (
            np.split(values.astype(np.float32), ends[:-1])
            for values in (self.all_depth, self.all_normals.reshape(-1, 3))
        )
        return {
            camera: ViewDepth(
                depth.reshape(view.height, view.width), facing.reshape(view.height, view.width, 3)
            )
            for (camera, view), depth, facing in zip(views.items(), depths, normals, strict=True)
        }


def compute_instant_depth(
    images: Mapping[str, InputImage],
    sources: Mapping[str, Sequence[str]],
    depth_ranges: Mapping[str, tuple[float, float]],
    reference: str,
    matcher: ChosenMatcher = SWEEP,
    planes: Array = NO_PLANES,
    still: StillScene | None = None,
) -> InstantDepth:
    """Match all cameras' images, check them against each other, and fuse the maps.

    `depth_ranges` holds each camera's depth range of the scene. `planes` are used if `still` has none yet.
    `still`: depth of earlier instants, reused where nothing moved; it also stores the new results.
    """
    views, pictures = image_views(images), image_colours(images)
    calibrated = {camera: image.calibrated for camera, image in images.items()}
    still = still or StillScene()
    still.look(calibrated)
    if still.planes is None and len(planes):
        still.planes = [ScenePlane(plane[:3], float(plane[3])) for plane in planes]
    with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
        found = match_cameras(matcher, Path(scratch), images, sources, depth_ranges, still=still)
    surfaces = {camera: _surface(view) for camera, view in found.items()}
    own = surfaces[reference]
    others = [camera for camera in surfaces if camera != reference]
    source_views = [SourceView(calibrated[reference], calibrated[other]) for other in others]
    voters = zip(source_views, (surfaces[other] for other in others), strict=True)
    votes = count_coinciding_views(own, voters)
    cloud = fuse_maps(views, found, pictures, smallest_group(sources))
    return InstantDepth(
        depth=found[reference].depth,
        consistent=votes >= min(CONFIRMING_VIEWS, len(others)),
        difference=_difference(own.inverse_depth, source_views),
        planes=np.array([(*plane.normal, plane.distance) for plane in still.planes or ()]).reshape(-1, 4),
        points=cloud.points,
        colours=cloud.colours,
        seen=cloud.seen,
        all_depth=np.concatenate([found[camera].depth.ravel() for camera in images]),
        all_normals=np.concatenate([found[camera].normals.ravel().astype(np.float16) for camera in images]),
    )


def _surface(view: ViewDepth) -> Surface:
    """Return the surface before our checks; for COLMAP, the depth that its own checks left (0 = unknown)."""
    if view.surface is not None:
        return view.surface
    inverse = np.where(view.depth > 0, 1 / np.maximum(view.depth, 1e-12), 0).astype(np.float32)
    flat = np.zeros_like(inverse)
    return Surface(inverse, flat, flat, flat)


def _difference(inverse_depth: Array, source_views: Sequence[SourceView]) -> Array:
    """Return the median over the sources of the brightness difference, after brightness matching."""
    differences = []
    for source_view in source_views:
        seen = CPU.warp(source_view, inverse_depth)
        seen = np.where((seen < 0) | (inverse_depth <= 0), np.nan, seen).astype(np.float32)
        reference = source_view.reference.grey
        differences.append(np.abs(reference - match_brightness(reference, seen)))
    return median_of_known(np.stack(differences))
