"""Blank walls: the surfaces that all views found, with planes where nothing but these tells their depth."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import CalibratedImage
from reconstruction.depth.plane_sweep import Refinement, Surface, SweepOptions, sweep_view
from reconstruction.depth.weak_texture.blank_part import WINDOW, BlankPart, extract_blank_part
from reconstruction.depth.weak_texture.plane_choice import choose_planes
from reconstruction.depth.weak_texture.plane_laying import lay_planes
from reconstruction.depth.weak_texture.scene_planes import (
    EVERY,
    MIN_SHARE,
    SurfacePoints,
    find_scene_planes,
    sample_surface,
)

MIN_BLANK_SHARE = 0.02
"""Share of the pictures that must be blank."""
EVIDENT, EVIDENT_WIDE = 0.5, 0.8
"""Matching costs below which a surface's points count, by the picture's windows and by wide ones."""
WIDE_SWEEP = SweepOptions(step_px=0.8, window=WINDOW, fine_window=WINDOW, refinements=(Refinement(0.35, 4),))


def settle_blank_walls(
    images: Mapping[str, CalibratedImage],
    sources: Mapping[str, Sequence[str]],
    reach: Mapping[str, tuple[float, float]],
    surfaces: Mapping[str, Surface],
    pool: Executor,
) -> dict[str, Surface]:
    """The views' surfaces with planes laid where pictures are blank and wide windows prefer them.

    The planes are those that many points of all views lie on.
    """
    names = list(surfaces)
    parts = dict(zip(names, pool.map(extract_blank_part, (images[name] for name in names)), strict=True))
    if np.mean([part.mask.mean() for part in parts.values()]) < MIN_BLANK_SHARE:
        return dict(surfaces)

    def sources_of(name: str) -> list[BlankPart]:
        return [parts[other] for other in sources[name]]

    def sample(name: str) -> list[SurfacePoints]:
        part, surface = parts[name], surfaces[name]
        level, cost = (_shrunk(one, part.image) for one in (surface.inverse_depth, surface.cost))
        near = sample_surface(part.image, level, cost < EVIDENT)
        wide = sweep_view(part.image, [other.image for other in sources_of(name)], *reach[name], WIDE_SWEEP)
        return [near, sample_surface(part.image, wide.inverse_depth, part.there & (wide.cost < EVIDENT_WIDE))]

    samples = [one for found in pool.map(sample, names) for one in found]
    least = round(MIN_SHARE / EVERY * float(np.mean([part.there.size for part in parts.values()])))
    planes = find_scene_planes(samples, least)

    def settle(name: str) -> Surface:
        part = parts[name]
        found = _shrunk(surfaces[name].inverse_depth, part.image)
        choice = choose_planes(part, sources_of(name), found, planes, reach[name])
        return lay_planes(surfaces[name], images[name], part.mask, choice)

    return dict(zip(names, pool.map(settle, names), strict=True))


def _shrunk(part: Array, image: CalibratedImage) -> Array:
    """A map at the size of a small picture, pixels as they are: a mean over an edge is on no surface."""
    size = image.view.width, image.view.height
    return np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_NEAREST))
