"""What single images of a camera show beside its offset: glitches, repeated images, unknown instants."""

from collections.abc import Collection, Iterator, Mapping
from itertools import pairwise

import cv2
import numpy as np
from msgspec import Struct

from capture_app.common.grouping import grouped
from capture_app.common.text import count
from reconstruction.common.geometry import Array
from reconstruction.common.templates import render_sentences
from reconstruction.scene.conditions import evenly_spaced
from reconstruction.scene.dataset import Dataset
from reconstruction.time_offsets.frame_jumps import BLUR_PX

WHOLE_FRAMES = 0.25
"""Maximum distance from a whole number of frames at which an image is called so many frames later."""
STALLED, MOVING = 0.25, 0.5
"""Change of a stalled image at most, and of the others' images at least, relative to the camera's median."""


class SingleImages(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Images of a camera that are not at its offset, or that do not show whether they are."""

    glitches_ms: dict[int, float] = {}
    """Instants whose points agree on another offset, each with the image's delay beyond the camera's."""
    repeated: tuple[int, ...] = ()
    """Instants whose image has the same bytes as the one before; they are left out of the measurement."""
    stalled: tuple[int, ...] = ()
    """Instants whose image shows nothing moved since the one before, though other cameras' images do."""
    odd_ms: dict[int, float] = {}
    """Instants whose own offset certainly differs though nothing explains it, each with the difference."""
    unvoted: tuple[int, ...] = ()
    """Instants that were examined and show no offset of their own."""
    examined: int = 0
    """Number of instants that were examined."""
    period_ms: float = 0.0
    """Time from frame to frame."""
    repeats_ms: float = 0.0
    """Period of all that moves: the offset may be a multiple of it more or less; 0 if it does not repeat."""
    rows_ms: float = 0.0
    """Delay of the last row beyond the middle one, against the same rows of the other camera."""
    moved: tuple[str, ...] = ()
    """Which cameras were moved during the take, and how: only a part of it was measured."""
    screens: tuple[str, ...] = ()
    """Cameras that show a screen, which was left out, as it has times of its own."""

    @property
    def span(self) -> str:
        """Which other offsets fit as well, to follow an offset; empty if none does."""
        return (
            f", or a multiple of {self.repeats_ms:.0f} ms more or less, as what moves repeats itself"
            if self.repeats_ms
            else ""
        )

    def describe(self, camera: str, than: str) -> Iterator[str]:
        """Yield a sentence about each kind, without a full stop."""
        glitches = sorted(self.glitches_ms.items())
        by_size = grouped((_later(ms, self.period_ms), instant) for instant, ms in glitches)
        yield from self.moved
        view = {"images": self, "camera": camera, "than": than, "by_size": by_size}
        for kind in ("screens", "rows", "glitches", "repeated", "stalled", "odd", "unvoted"):
            if text := render_sentences("single_images.txt", __package__, kind=kind, **view):
                yield text


def _later(ms: float, period_ms: float) -> str:
    frames = round(ms / period_ms)
    side = "later" if ms > 0 else "earlier"
    if frames and abs(ms / period_ms - frames) < WHOLE_FRAMES:
        return f"{count(abs(frames), 'frame')} {side}"
    return f"{abs(ms):.0f} ms {side}"


def repeated_images(dataset: Dataset, camera: str) -> tuple[int, ...]:
    """Return the instants whose image has the bytes of the camera's image before: a repeated frame.

    A sensor's noise makes two frames differ. Where all cameras' images are equal, nothing moved.
    """
    again = {name: _equal_images(dataset, name) for name in dataset.cameras}
    return tuple(k for k in sorted(again[camera]) if any(k not in others for others in again.values()))


def stalled_images(dataset: Dataset, cameras: Collection[str]) -> dict[str, tuple[int, ...]]:
    """Return each camera's instants at which nothing moved since its image before, though it did for another.

    A repeated frame that was compressed again is one, or an image of the moment of its neighbour. Something
    moves in the camera's own images before and after. Long takes are searched in parts.
    """
    changes = {name: _changes(dataset, name) for name in cameras}
    return {
        name: tuple(
            k
            for k in own
            if own[k] < STALLED
            and any(other.get(k, 0.0) > MOVING for camera, other in changes.items() if camera != name)
            and all(max(own.get(k + side, 0.0), own.get(k + 2 * side, 0.0)) > MOVING for side in (-1, 1))
        )
        for name, own in changes.items()
    }


def _changes(dataset: Dataset, camera: str) -> dict[int, float]:
    """Return the differences of images from the ones before, relative to the median."""
    known = dataset.instants(camera)
    # In six parts of the take, four instants to either side of each middle.
    near = {k for middle in evenly_spaced(known, 6) for k in range(middle - 4, middle + 5)}
    blurred = dict[int, Array]()
    for k in sorted(near.intersection(known)):
        if dataset.has_image(camera, k):
            image = dataset.grey(camera, k).astype(np.float32)
            blurred[k] = cv2.GaussianBlur(image, (0, 0), BLUR_PX)
    sizes = {
        k: float(np.percentile(np.abs(image - blurred[k - 1]), 99.9))
        for k, image in blurred.items()
        if k - 1 in blurred
    }
    usual = max(float(np.median([*sizes.values()] or [0.0])), 1e-6)
    return {k: size / usual for k, size in sizes.items()}


def _equal_images(dataset: Dataset, camera: str) -> set[int]:
    digests = {k: dataset.record(camera, k).sha256 for k in dataset.instants(camera)}
    return {k for before, k in pairwise(digests) if digests[k] == digests[before]}


def common_glitches(of_pairs: Collection[Mapping[int, float]]) -> dict[int, float]:
    """Return the glitches that a camera has in all pairs that it is in, each with the first pair's size."""
    first, *others = of_pairs
    return {k: ms for k, ms in first.items() if all(ms * other.get(k, 0.0) > 0 for other in others)}
