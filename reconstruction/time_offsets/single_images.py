"""What single images of a camera show beside its offset: glitches, repeated images, unknown instants."""

from collections.abc import Collection, Iterator, Mapping
from itertools import pairwise

from msgspec import Struct

from capture_app.common.text import count
from reconstruction.scene.dataset import Dataset

WHOLE_FRAMES = 0.25
"""Maximum distance from a whole number of frames at which an image is called so many frames later."""
MAX_UNVOTED = 0.2
"""Maximum fraction of instants without an offset of their own that is not worth a sentence."""
MAX_NAMED = 8
"""Maximum number of instants named in a sentence."""


class SingleImages(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Images of a camera that are not at its offset, or that do not show whether they are."""

    glitches_ms: dict[int, float] = {}
    """Instants whose points agree on another offset, and how much later the camera's image is there."""
    repeated: tuple[int, ...] = ()
    """Instants whose image has the same bytes as the one before; they are left out of the measurement."""
    unvoted: tuple[int, ...] = ()
    """Instants that were examined and show no offset of their own."""
    examined: int = 0
    """Number of instants that were examined."""
    period_ms: float = 0.0
    """Time from frame to frame."""

    def describe(self, camera: str, than: str) -> Iterator[str]:
        """Yield a sentence about each kind, without a full stop."""
        if self.glitches_ms:
            late: dict[str, list[int]] = {}
            for instant, ms in sorted(self.glitches_ms.items()):
                late.setdefault(_later(ms, self.period_ms), []).append(instant)
            places = "; ".join(f"{size} at {_named(instants)}" for size, instants in late.items())
            some = f"{len(self.glitches_ms)} of {self.examined} instants"
            yield f"{camera} differs from {than} at {some}: {places}"
        if self.repeated:
            images = count(len(self.repeated), "image")
            yield f"{camera} repeats {images}, at {_named(self.repeated)}: the same bytes as the image before"
        if len(self.unvoted) > MAX_UNVOTED * self.examined:
            yield (
                f"{len(self.unvoted)} of {self.examined} instants do not show {camera}'s offset: "
                f"too little moves across the epipolar lines at {_named(self.unvoted)}"
            )


def _later(ms: float, period_ms: float) -> str:
    frames = round(ms / period_ms)
    side = "later" if ms > 0 else "earlier"
    if frames and abs(ms / period_ms - frames) < WHOLE_FRAMES:
        return f"{count(abs(frames), 'frame')} {side}"
    return f"{abs(ms):.0f} ms {side}"


def _named(instants: Collection[int]) -> str:
    more = len(instants) - MAX_NAMED
    named = ", ".join(str(k) for k, _ in zip(sorted(instants), range(MAX_NAMED), strict=False))
    return f"{named} and {more} more" if more > 0 else named


def repeated_images(dataset: Dataset, camera: str) -> tuple[int, ...]:
    """Return the instants whose image has the bytes of the camera's image before: a repeated frame.

    A sensor's noise makes two frames differ. Where all cameras' images are equal, nothing moved.
    """
    again = {name: _equal_images(dataset, name) for name in dataset.cameras}
    return tuple(k for k in sorted(again[camera]) if any(k not in others for others in again.values()))


def _equal_images(dataset: Dataset, camera: str) -> set[int]:
    digests = {k: dataset.record(camera, k).sha256 for k in dataset.instants(camera)}
    return {k for before, k in pairwise(digests) if digests[k] == digests[before]}


def common_glitches(of_pairs: Collection[Mapping[int, float]]) -> dict[int, float]:
    """Return the glitches that a camera has in all pairs that it is in, each with the first pair's size."""
    first, *others = of_pairs
    return {k: ms for k, ms in first.items() if all(ms * other.get(k, 0.0) > 0 for other in others)}
