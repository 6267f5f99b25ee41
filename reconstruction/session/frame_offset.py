"""Which two frames of a burst are compared as "offset": those about so many milliseconds apart."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np

from capture_app.errors import BadInputError
from reconstruction.session.dataset import Dataset

Item = TypeVar("Item")


@dataclass(frozen=True)
class FrameOffset:
    """A distance between instants of a burst, and the pairs of instants that are so far apart."""

    asked_ms: float
    actual_ns: int
    frames: int
    """In frames of the cameras."""
    step: int
    """In instants of the burst, where these are evenly spaced."""
    pairs: tuple[tuple[int, int], ...]
    """(instant, the instant that is `actual_ns` later)."""

    @property
    def reversed(self) -> "FrameOffset":
        """The same distance the other way: the second of each pair is earlier."""
        pairs = tuple((later, now) for now, later in self.pairs)
        return replace(
            self, asked_ms=-self.asked_ms, actual_ns=-self.actual_ns, frames=-self.frames, pairs=pairs
        )

    @property
    def actual_ms(self) -> float:
        """The distance that the burst has, ms."""
        return self.actual_ns / 1e6


def nearest_frame_offset(instants_ns: Sequence[int], period_ns: int, offset_ms: float) -> FrameOffset:
    """The distance between instants of the burst that is nearest to the offset asked for.

    Raises:
        BadInputError: the burst is too short for it, or its frames too far apart.
    """
    if len(instants_ns) < 2:
        raise BadInputError(
            "the session has one instant only, so no frame can be offset", hint="take a burst of 5 or more"
        )
    spacing = min(b - a for a, b in pairwise(instants_ns))
    asked_ns = round(offset_ms * 1e6)
    distances = sorted({b - a for i, a in enumerate(instants_ns) for b in instants_ns[i + 1 :]})
    nearest = min(distances, key=lambda d: (abs(d - asked_ns), d))
    if asked_ns > distances[-1] + spacing / 2:
        raise BadInputError(
            f"the burst is too short for an offset of {offset_ms:g} ms",
            hint=f"the largest offset possible is {distances[-1] / 1e6:.0f} ms",
        )
    if abs(nearest - asked_ns) > spacing / 2:
        raise BadInputError(
            f"no two frames of the burst are about {offset_ms:g} ms apart",
            hint=f"the nearest offset possible is {nearest / 1e6:.1f} ms",
        )
    slack = spacing / 4
    pairs = tuple(
        (i, j)
        for i, a in enumerate(instants_ns)
        for j, b in enumerate(instants_ns)
        if abs(b - a - nearest) <= slack
    )
    return FrameOffset(
        offset_ms, nearest, round(nearest / period_ns), max(1, round(nearest / spacing)), pairs
    )


def pairs_with_images(
    dataset: Dataset, offset: FrameOffset, reference: str, other: str
) -> list[tuple[int, int]]:
    """The instants for which both conditions have all their images."""
    return [
        (now, later)
        for now, later in offset.pairs
        if dataset.has_images(((reference, now), (other, now), (other, later)))
    ]


def evenly_spread(items: Sequence[Item], limit: int) -> list[Item]:
    """At most `limit` of them, evenly spread; a single one from the middle."""
    if len(items) <= limit:
        return list(items)
    if limit == 1:
        return [items[len(items) // 2]]
    return [items[round(i)] for i in np.linspace(0, len(items) - 1, limit)]
