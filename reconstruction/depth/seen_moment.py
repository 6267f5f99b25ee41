"""One moment as several cameras saw it: their undistorted pictures with depth."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import cv2
import msgspec
import numpy as np

from capture_app.common.text import pretty_json
from capture_app.session.files.untrusted_files import read_arrays
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import CALIBRATION
from reconstruction.common.geometry import Array, View, resize_view
from reconstruction.common.image_files import read_image, write_image

MIDDLE = 0.5
"""Fraction of each side of the pictures, around their middle, that is taken for the subject."""


@dataclass(frozen=True, eq=False)
class SeenView:
    """One camera of a moment.

    `view` has no distortion; `colours` are uint8 height x width x 3, BGR; `depth` is float32 height x width
    in the calibration's unit, 0 = unknown; `normals` are float32 height x width x 3 in the camera's frame.
    """

    view: View
    colours: Array
    depth: Array
    normals: Array

    def resized(self, max_side_px: int) -> "SeenView":
        """Return the view with at most this many pixels on its longer side."""
        scale = max_side_px / max(self.view.width, self.view.height)
        if scale >= 1:
            return self
        size = round(self.view.width * scale), round(self.view.height * scale)
        return SeenView(
            resize_view(self.view, *size),
            np.asarray(cv2.resize(self.colours, size, interpolation=cv2.INTER_AREA)),
            # A mean of two surfaces is none.
            np.asarray(cv2.resize(self.depth, size, interpolation=cv2.INTER_NEAREST)),
            np.asarray(cv2.resize(self.normals, size, interpolation=cv2.INTER_NEAREST)),
        )

    def within(self, mask: Array) -> "SeenView":
        """Return the view black and without depth outside a mask (bool), which may have another size."""
        inside = cv2.resize(mask.astype(np.uint8), self.depth.shape[::-1], interpolation=cv2.INTER_NEAREST)
        return replace(self, colours=self.colours * inside[..., None], depth=self.depth * inside)


Moment = Mapping[str, SeenView]
"""The cameras of one moment by name."""


class SeenInstant(NamedTuple):
    """One instant as its cameras saw it, and why other cameras are left out."""

    instant: int
    moment: Moment
    left_out: Mapping[str, str]


def save_moment(folder: Path, moment: Moment, unit: str) -> None:
    """Write a moment's maps, its undistorted pictures and their cameras into a new folder."""
    folder.mkdir(parents=True)
    for camera, seen in moment.items():
        np.savez(folder / f"{camera}.npz", depth=seen.depth, normals=seen.normals.astype(np.float16))
        write_image(folder / f"{camera}.png", seen.colours)
    cameras = {camera: seen.view.to_calibration() for camera, seen in moment.items()}
    (folder / CALIBRATION).write_bytes(pretty_json(Calibration(cameras=cameras, unit=unit)))


def load_moment(folder: Path) -> Moment:
    """Return a moment that `save_moment` wrote."""
    cameras = msgspec.json.decode((folder / CALIBRATION).read_bytes(), type=Calibration).cameras
    return {
        camera: _seen(
            View.from_calibration(lens, lens.width, lens.height),
            read_image(folder / f"{camera}.png"),
            read_arrays(folder / f"{camera}.npz"),
        )
        for camera, lens in cameras.items()
    }


def _seen(view: View, colours: Array, maps: Mapping[str, Array]) -> SeenView:
    return SeenView(view, colours, *(np.asarray(maps[name], np.float32) for name in ("depth", "normals")))


def find_subject(moment: Moment) -> Array:
    """Return the point (3,) around which paths turn: the median of what the pictures' middles show."""
    points = []
    for seen in moment.values():
        height, width = seen.depth.shape
        rows, columns = (
            slice(round(n * (1 - MIDDLE) / 2), round(n * (1 + MIDDLE) / 2)) for n in (height, width)
        )
        inside = np.zeros(seen.depth.shape, bool)
        inside[rows, columns] = seen.depth[rows, columns] > 0
        points.append(seen.view.unproject_map(seen.depth, inside))
    return np.asarray(np.median(np.concatenate(points), axis=0))
