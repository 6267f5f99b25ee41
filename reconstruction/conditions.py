"""Conditions of a comparison as data: how late each camera is."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture_app.errors import BadInputError
from reconstruction.dataset import Dataset
from reconstruction.variants import Offset, choose_offset

DRAWN_MS = (-66.0, -33.0, 0.0, 33.0, 66.0)


@dataclass(frozen=True)
class Condition:
    """A name, and by how much each camera is late, ms; cameras that are not named are on time."""

    name: str
    offsets_ms: tuple[tuple[str, float], ...]

    def between_ms(self, first: str, second: str) -> float:
        """How much later than the first camera the second is: all that a pair can see of a condition."""
        offsets = dict(self.offsets_ms)
        return offsets.get(second, 0.0) - offsets.get(first, 0.0)


def drawn(cameras: Sequence[str], seed: int = 0) -> Condition:
    """Every camera late by one of DRAWN_MS, all different where there are no more than five cameras.

    Equal offsets hide what an offset does: cameras that share one agree with each other.
    """
    rng = np.random.default_rng(seed)
    offsets: list[float] = []
    while len(offsets) < len(cameras):
        offsets += [DRAWN_MS[i] for i in rng.permutation(len(DRAWN_MS))]
    return Condition("drawn", tuple(zip(cameras, offsets, strict=False)))


def check_cameras(dataset: Dataset, condition: Condition) -> None:
    """Refuse a condition with cameras that the session does not have."""
    for name, _ in condition.offsets_ms:
        dataset.session.camera(name)


def pair_offset(dataset: Dataset, condition: Condition, first: str, second: str) -> Offset:
    """The instants that a pair's images come from in a condition.

    Raises:
        ValueError: both are equally late, or the burst does not hold such an offset.
    """
    asked_ms = condition.between_ms(first, second)
    if asked_ms == 0:
        raise ValueError(f"{first} and {second} are equally late, which is synchronized for these two")
    try:
        found = choose_offset(dataset.instants_ns, dataset.period_ns, abs(asked_ms))
    except BadInputError as error:
        raise ValueError(str(error)) from error
    if asked_ms > 0:
        return found
    return replace(
        found,
        asked_ms=asked_ms,
        actual_ns=-found.actual_ns,
        frames=-found.frames,
        pairs=tuple((later, now) for now, later in found.pairs),
    )
