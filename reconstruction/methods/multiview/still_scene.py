"""Depth reuse for static scenes: later instants sweep only boxes around moving or uncovered areas."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import OUTSIDE, CalibratedImage, SourceView, box_filter
from reconstruction.depth.plane_sweep import Surface
from reconstruction.depth.rough_scene import RoughScene
from reconstruction.depth.sweep_kernels import warp
from reconstruction.methods.multiview.blank_walls import ScenePlane

WIDER_PX = 6
"""Margin around changes, where windows include part of them."""

Box = tuple[slice, slice]
WHOLE: Box = (slice(None), slice(None))


class StillScene:
    """Results of a session's earlier instants, and the areas where they do not hold for the current one."""

    def __init__(self) -> None:
        self.scene: RoughScene | None = None
        """Coarse location of the scene; None if it must be found first."""
        self.planes: list[ScenePlane] | None = None
        """Planes on which blank walls may be; None if they must be found first."""
        self._new: dict[str, Array] = {}
        """Pixels to be swept (bool), by camera; empty: everything."""
        self._surfaces: dict[str, Surface] = {}
        self._cameras: set[str] = set()
        self._pictures: dict[str, Array] = {}
        """Grey levels when depth was found; `OUTSIDE` if something moved or hid the pixel from a source."""

    def look(self, images: Mapping[str, CalibratedImage]) -> None:
        """Compare an instant's images with earlier ones, and mark moving and changed pixels to be swept."""
        before, self._cameras, self._new = self._cameras, set(images), {}
        for name, known in self._pictures.items() if before == self._cameras else ():
            moved, grey = known == OUTSIDE, images[name].grey
            # A window of 5 px has changed since its depth was found.
            off = np.abs(box_filter(np.where(moved, 0, grey - known), 5)) > 8.0
            self._new[name] = _wider(off, WIDER_PX) | moved | _moving(images[name])
        # Light or a camera has changed.
        if not self._new or np.mean([new.mean() for new in self._new.values()]) > 0.6:
            self.scene, self.planes, self._new, self._pictures = None, None, {}, {}

    def new(self, name: str, image: CalibratedImage) -> Array:
        """Return the pixels of a camera's image that must be swept (bool)."""
        return self._new.get(name, np.ones(image.grey.shape, bool))

    def surface(self, name: str, image: CalibratedImage) -> Surface:
        """Return the surface found so far for a camera's image."""
        return self._surfaces.get(name) or Surface(*np.zeros((4, *image.grey.shape), np.float32))

    def keep(
        self,
        images: Mapping[str, CalibratedImage],
        sources: Mapping[str, Sequence[str]],
        surfaces: Mapping[str, Surface],
    ) -> None:
        """Store the surfaces of these images; pixels beside or behind moving objects are swept again."""
        self._surfaces |= surfaces
        moving = {name: _wider(_moving(image), WIDER_PX) for name, image in images.items()}
        for name, surface in surfaces.items():
            image, hidden = images[name], moving[name]
            for other in sources[name]:
                seen = replace(images[other], grey=moving[other].astype(np.float32))
                hidden = hidden | (warp(SourceView(image, seen), surface.inverse_depth) > 0)
            shown = np.where(hidden, np.float32(OUTSIDE), image.grey)
            self._pictures[name] = np.where(self._new.get(name, True), shown, self._pictures.get(name, shown))


def _moving(image: CalibratedImage) -> Array:
    return np.zeros(image.grey.shape, bool) if image.moving is None else image.moving


def _wider(mask: Array, radius_px: int) -> Array:
    side = 2 * radius_px + 1
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0)


def boxes_around(new: Array) -> list[tuple[Box, Array]]:
    """Return boxes that cover a mask (bool) with a margin, and the part of the mask in each (bool)."""
    # Windows and paths start in the margin.
    _, parts, boxes, _ = cv2.connectedComponentsWithStats(_wider(new, 12).astype(np.uint8))
    # The first component is the outside.
    return [
        ((slice(top, top + height), slice(left, left + width)), new & (parts == part))
        for part, (left, top, width, height, _) in enumerate(boxes.tolist())
        if part
    ]


def renewed(surface: Surface, swept: Surface, box: Box, new: Array) -> Surface:
    """Return the surface with a box's sweep copied in where `new` (bool, of the whole image) is set."""
    copied = Surface(*(part.copy() for part in surface))
    for part, now in zip(copied, swept, strict=True):
        np.copyto(part[box], now, where=new[box])
    return copied
