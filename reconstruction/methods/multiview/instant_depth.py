"""Depth of one instant as its files hold it: all cameras' maps and the fused cloud."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.common.image_matching import match_brightness
from reconstruction.depth.calibrated_image import CalibratedImage, SourceView
from reconstruction.depth.geometric_consistency import count_coinciding_views
from reconstruction.depth.plane_sweep import Surface
from reconstruction.depth.sweep_kernels import warp
from reconstruction.methods.multiview.fusion import FusedCloud, median_of_known
from reconstruction.methods.multiview.instant_maps import InstantMaps
from reconstruction.methods.multiview.sweep_matcher import ViewDepth


class InstantDepth(NamedTuple):
    """Depth and normals (float16) of all cameras at an instant, and the cloud fused from all."""

    maps: Mapping[str, ViewDepth]
    cloud: FusedCloud

    @classmethod
    def of(cls, instant: InstantMaps) -> Self:
        """Return what the files of a result hold."""
        maps = {c: ViewDepth(view.depth, view.normals.astype(np.float16)) for c, view in instant.maps.items()}
        return cls(maps, instant.cloud)


def confirm(
    reference: str, images: Mapping[str, CalibratedImage], maps: Mapping[str, ViewDepth]
) -> tuple[Array, Array]:
    """Return where two other cameras' maps confirm the reference's (bool), and how its picture differs.

    The difference is in grey levels between the reference and the others, warped by its depth: the median,
    NaN = no depth, or none sees it.
    """
    surfaces = {camera: _surface(view.depth) for camera, view in maps.items()}
    own = surfaces[reference]
    others = [camera for camera in surfaces if camera != reference]
    source_views = [SourceView(images[reference], images[other]) for other in others]
    voters = zip(source_views, (surfaces[other] for other in others), strict=True)
    votes = count_coinciding_views(own, voters)
    confirmed = (own.inverse_depth > 0) & (votes >= min(2, len(others)))
    return confirmed, _difference(own.inverse_depth, source_views)


def _surface(depth: Array) -> Surface:
    inverse = np.where(depth > 0, 1 / np.maximum(depth, 1e-12), 0).astype(np.float32)
    flat = np.zeros_like(inverse)
    return Surface(inverse, flat, flat, flat)


def _difference(inverse_depth: Array, source_views: Sequence[SourceView]) -> Array:
    """Return the median over the sources of the brightness difference, after brightness matching."""
    differences = []
    for source_view in source_views:
        seen = warp(source_view, inverse_depth)
        seen = np.where((seen < 0) | (inverse_depth <= 0), np.nan, seen).astype(np.float32)
        reference = source_view.reference.grey
        differences.append(np.abs(reference - match_brightness(reference, seen)))
    return median_of_known(np.stack(differences))
