"""Depth of one instant as its files hold it: all cameras' maps and the fused cloud."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.common.image_matching import match_brightness
from reconstruction.depth.calibrated_image import CalibratedImage, SourceView
from reconstruction.depth.geometric_consistency import count_coinciding_views
from reconstruction.depth.plane_sweep import Surface
from reconstruction.depth.sweep_engine import CPU
from reconstruction.methods.multiview.fusion import median_of_known
from reconstruction.methods.multiview.instant_maps import InstantMaps
from reconstruction.methods.multiview.sweep_matcher import ViewDepth

CONFIRMING_VIEWS = 2
"""Number of other views that must find a depth for it to be called consistent."""


@dataclass(frozen=True, eq=False)
class InstantDepth:
    """Depth of all cameras at an instant, and the cloud fused from it in the rig's frame.

    `cameras` (n,) are names. `all_depth` (float32) and `all_normals` (float16, x 3) are their undistorted
    maps, flat, one after the other. `points` (n, 3) are float32 with `colours` (n, 3), uint8 RGB.
    """

    cameras: Array
    all_depth: Array
    all_normals: Array
    points: Array
    colours: Array

    @classmethod
    def of(cls, found: InstantMaps) -> Self:
        """Return what the files of a result hold."""
        maps = found.maps.values()
        return cls(
            cameras=np.array(list(found.maps)),
            all_depth=np.concatenate([one.depth.ravel() for one in maps]),
            all_normals=np.concatenate([one.normals.ravel().astype(np.float16) for one in maps]),
            points=found.cloud.points,
            colours=found.cloud.colours,
        )

    def maps(self, views: Mapping[str, View]) -> dict[str, ViewDepth]:
        """Return the maps by camera; `views` has the cameras' undistorted views."""
        names = self.cameras.tolist()
        ends = np.cumsum([views[name].width * views[name].height for name in names])[:-1]
        depths = np.split(self.all_depth, ends)
        normals = np.split(self.all_normals.reshape(-1, 3).astype(np.float32), ends)
        return {
            name: ViewDepth(
                depth.reshape(views[name].height, views[name].width),
                facing.reshape(views[name].height, views[name].width, 3),
            )
            for name, depth, facing in zip(names, depths, normals, strict=True)
        }


def confirm(
    reference: str, images: Mapping[str, CalibratedImage], maps: Mapping[str, ViewDepth]
) -> tuple[Array, Array]:
    """Return where two other cameras' maps confirm the reference's (bool), and how its picture differs.

    The difference is in grey levels between the reference and the others, warped by its depth: the median,
    NaN = no depth, or none sees it.
    """
    surfaces = {camera: _surface(found.depth) for camera, found in maps.items()}
    own = surfaces[reference]
    others = [camera for camera in surfaces if camera != reference]
    source_views = [SourceView(images[reference], images[other]) for other in others]
    voters = zip(source_views, (surfaces[other] for other in others), strict=True)
    votes = count_coinciding_views(own, voters)
    confirmed = (own.inverse_depth > 0) & (votes >= min(CONFIRMING_VIEWS, len(others)))
    return confirmed, _difference(own.inverse_depth, source_views)


def _surface(depth: Array) -> Surface:
    inverse = np.where(depth > 0, 1 / np.maximum(depth, 1e-12), 0).astype(np.float32)
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
