"""What stands still needs depth once: later instants sweep boxes around what moves, and what it uncovered."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import OUTSIDE, CalibratedImage, SourceView, box_filter
from reconstruction.depth.coarse_scene import CoarseScene
from reconstruction.depth.compiled import CPU
from reconstruction.depth.plane_sweep import Surface

CHANGED_GREY, CHANGED_WINDOW = 8.0, 5
"""Grey levels by which the mean of a window of so many px differs from when a depth was found there."""
WIDER_PX = 6
"""Around what has changed, whose windows show some of it."""
MARGIN_PX = 12
"""Around what a box is for, where its windows and paths begin."""
MOST_NEW = 0.6
"""Share of the pictures from which on all is swept again: the light has changed, or a camera was nudged."""

Box = tuple[slice, slice]
WHOLE: Box = (slice(None), slice(None))


class StillScene:
    """What earlier instants of a session found, and what of that does not hold for the one looked at."""

    def __init__(self) -> None:
        self.scene: CoarseScene | None = None
        """Where the scene is; None where that is to be found."""
        self._new: dict[str, Array] = {}
        """What is to be swept (bool); empty: all of all."""
        self._surfaces: dict[str, Surface] = {}
        self._cameras: set[str] = set()
        self._pictures: dict[str, Array] = {}
        """Grey levels by which depth was found; `OUTSIDE` where something moved, or hid it from a source."""

    def look(self, images: Mapping[str, CalibratedImage]) -> None:
        """Look at an instant's pictures: what moves, or looks otherwise than when its depth was found?"""
        before, self._cameras, self._new = self._cameras, set(images), {}
        for name, known in self._pictures.items() if before == self._cameras else ():
            moved, grey = known == OUTSIDE, images[name].grey
            off = np.abs(box_filter(np.where(moved, 0, grey - known), CHANGED_WINDOW)) > CHANGED_GREY
            self._new[name] = _wider(off, WIDER_PX) | moved | _moving(images[name])
        if not self._new or np.mean([one.mean() for one in self._new.values()]) > MOST_NEW:
            self.scene, self._new, self._pictures = None, {}, {}

    def new(self, name: str, image: CalibratedImage) -> Array:
        """What is to be swept of a camera's picture (bool)."""
        return self._new.get(name, np.ones(image.grey.shape, bool))

    def surface(self, name: str, image: CalibratedImage) -> Surface:
        """What was found of a camera's picture until now."""
        return self._surfaces.get(name) or Surface(*np.zeros((4, *image.grey.shape), np.float32))

    def keep(
        self,
        images: Mapping[str, CalibratedImage],
        sources: Mapping[str, Sequence[str]],
        surfaces: Mapping[str, Surface],
    ) -> None:
        """Keep what was found of these pictures: beside and behind what moves until that has gone on."""
        self._surfaces |= surfaces
        moving = {name: _wider(_moving(image), WIDER_PX) for name, image in images.items()}
        for name, surface in surfaces.items():
            image, hidden = images[name], moving[name]
            for other in sources[name]:
                seen = replace(images[other], grey=moving[other].astype(np.float32))
                hidden = hidden | (CPU.warp(SourceView(image, seen), surface.inverse_depth) > 0)
            shown = np.where(hidden, np.float32(OUTSIDE), image.grey)
            known = self._pictures.get(name, shown)
            self._pictures[name] = np.where(self._new.get(name, True), shown, known)


def _moving(image: CalibratedImage) -> Array:
    return np.zeros(image.grey.shape, bool) if image.moving is None else image.moving


def _wider(mask: Array, radius_px: int) -> Array:
    side = 2 * radius_px + 1
    wide = cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8))
    return np.asarray(wide > 0)


def boxes_around(new: Array) -> list[tuple[Box, Array]]:
    """Boxes that hold all of a mask (bool) and a margin, and what of the mask each is for (bool)."""
    wide = _wider(new, MARGIN_PX).astype(np.uint8)
    _, parts, boxes, _ = cv2.connectedComponentsWithStats(wide)
    # The first is all that lies outside.
    return [
        ((slice(top, top + height), slice(left, left + width)), new & (parts == part))
        for part, (left, top, width, height, _) in enumerate(boxes.tolist())
        if part
    ]


def renewed(surface: Surface, swept: Surface, box: Box, new: Array) -> Surface:
    """The surface with what was swept in a box where that is new (bool, of the whole picture)."""
    found = Surface(*(part.copy() for part in surface))
    for part, now in zip(found, swept, strict=True):
        np.copyto(part[box], now, where=new[box])
    return found
