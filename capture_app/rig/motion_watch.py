"""Motion detection in cameras' previews: a trigger that needs no operator."""

from collections.abc import AsyncGenerator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from capture_app.protocol.status import Preview
from capture_app.rig.rig_link import RigLink
from capture_app.session.reading.decoding import decode_preview

WIDTH_PX, FPS = 160, 10.0
LEARN = 8
"""Number of images of a camera before motion is reported."""
MIN_LEVELS, CLEAR = 10.0, 6.0
"""Minimum change of a pixel, in grey levels and in multiples of its typical difference."""
Region = tuple[float, float, float, float]
WHOLE: Region = (0.0, 0.0, 1.0, 1.0)
"""Left, top, right and bottom, as fractions of the image."""


@dataclass(slots=True)
class MotionWatch:
    """Motion detector with a background model of each camera's region.

    Motion is a change of at least `min_fraction` of the region's pixels.
    """

    region: Region = WHOLE
    min_fraction: float = 0.005
    _views: dict[str, tuple[NDArray[np.float32], NDArray[np.float32], int]] = field(default_factory=dict)
    """Mean and deviation of each camera's pixels, and the number of its images so far."""

    def moved(self, camera: str, grey: NDArray[np.uint8]) -> bool:
        """Return whether a camera's next image (H x W) shows motion; global light changes do not count."""
        left, top, right, bottom = self.region
        height, width = grey.shape
        rows = slice(int(top * height), max(int(top * height) + 1, round(bottom * height)))
        columns = slice(int(left * width), max(int(left * width) + 1, round(right * width)))
        picture = grey[rows, columns].astype(np.float32)
        known = self._views.get(camera)
        if known is None or known[0].shape != picture.shape:
            self._views[camera] = picture, np.zeros_like(picture), 1
            return False
        mean, deviation, seen = known
        brighter = np.median((picture + 1) / (mean + 1))
        difference = np.abs(picture - brighter * mean)
        changed = float((difference > np.maximum(MIN_LEVELS, CLEAR * deviation)).mean())
        # At least a tenth, so that a lasting change becomes background after some images.
        weight = max(0.1, 1 / (seen + 1))
        mean += weight * (picture - mean)
        deviation += weight * (np.minimum(difference, MIN_LEVELS) - deviation)
        self._views[camera] = mean, deviation, seen + 1
        return seen >= LEARN and changed > self.min_fraction


async def watch_motion(link: RigLink, watch: MotionWatch) -> AsyncGenerator[Preview, None]:
    """Yield each preview that shows motion, forever; no previews arrive while a burst is sent."""
    await link.want_previews(cameras=None, width=WIDTH_PX, fps=FPS)
    async for update in link.updates():
        if (
            isinstance(update, Preview)
            and (pixels := decode_preview(update.jpeg)) is not None
            and watch.moved(update.camera, pixels.mean(2).astype(np.uint8))
        ):
            yield update
