"""Selection of instants: what cameras show in a condition, and where there is motion to measure."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from capture_app.common.errors import BadInputError
from reconstruction.scene.conditions import (
    DISTINCT_MS,
    SYNCED,
    Condition,
    FrameOffset,
    evenly_spaced,
    nearest_frame_offset,
    pairs_with_images,
)
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.moving_pixels import SceneMotion

MIN_MOVING = 0.0001
"""Minimum moving fraction of the image in every camera."""
MIN_INSTANTS = 3
"""Minimum number of instants, as with fewer an offset's error bar is not reliable; if fewer show that much
motion, those with the most motion are used."""


@dataclass(frozen=True)
class ShownInstant:
    """The instant that each camera shows while the reference shows `instant`."""

    instant: int
    shown: dict[str, int]

    @property
    def together(self) -> dict[str, int]:
        """Instants of the synchronized condition, by camera."""
        return dict.fromkeys(self.shown, self.instant)

    @property
    def by_condition(self) -> dict[str, dict[str, int]]:
        """Instants of both conditions, `synced` and `offset`."""
        return {"synced": self.together, "offset": self.shown}

    def delays_ms(self, dataset: Dataset) -> dict[str, float]:
        """Return each camera's delay, as `offset_CAMERA_ms`."""
        times = dataset.instants_ns
        return {f"offset_{c}_ms": (times[k] - times[self.instant]) / 1e6 for c, k in self.shown.items()}


def fixed_offsets_ms(condition: Condition, dataset: Dataset) -> dict[str, float]:
    """Return each camera's constant delay, ms; empty if delays are drawn for each instant."""
    offsets = () if condition.drawn else condition.offsets_ms(dataset.cameras, 0)
    return dict(zip(dataset.cameras, offsets, strict=False))


def relative_offsets_ms(
    condition: Condition, dataset: Dataset, reference: str, cameras: Sequence[str]
) -> dict[str, float]:
    """Return the constant delays of some cameras relative to the reference, ms, as `fixed_offsets_ms`."""
    late_ms = fixed_offsets_ms(condition, dataset)
    return {c: late_ms[c] - late_ms[reference] for c in cameras} if late_ms else {}


def instants_shown(dataset: Dataset, condition: Condition, instant: int) -> dict[str, int]:
    """Return the instant that each camera shows for an instant in a condition.

    Delays that are drawn, and count from an `anchor`'s, are drawn until they fit into the burst.

    Raises:
        BadInputError: there is no such instant, or the burst is too short on one side of it.
    """
    draws = 400 if condition.drawn and condition.anchor else 1
    for draw in range(draws):
        try:
            return dataset.nearest_instants(instant, condition.offsets_ms(dataset.cameras, instant, draw))
        except BadInputError:
            if draws == 1:
                raise
    raise BadInputError(f"the burst is too short to draw different offsets around instant {instant}")


def complete_instants(
    dataset: Dataset, condition: Condition, reference: str, cameras: Sequence[str], min_cameras: int = 1
) -> list[ShownInstant]:
    """Return the instants with images of the most cameras, both synchronized and in `condition`.

    At least `min_cameras` cameras must have both images. The reference keeps its own image, so that all that
    is judged on its pixels is the same in every condition.

    Raises:
        ValueError: there is no such instant, or the condition is the synchronized one under another name.
    """
    instants = []
    problem = "no instant has its pictures in both conditions"
    for instant in dataset.instants(reference):
        try:
            shown = instants_shown(dataset, condition.kept_at(reference), instant)
        except BadInputError as error:
            problem = str(error)
        else:
            with_images = {c: shown[c] for c in cameras if dataset.has_images(((c, instant), (c, shown[c])))}
            if len(with_images) >= min_cameras:
                instants.append(ShownInstant(instant, with_images))
    if not instants:
        raise ValueError(problem)
    max_cameras = max(len(moment.shown) for moment in instants)
    complete = [moment for moment in instants if len(moment.shown) == max_cameras]
    refuse_synchronized(condition, [(moment.instant, moment.shown) for moment in complete])
    return complete


def refuse_synchronized(condition: Condition, shown: Iterable[tuple[int, Mapping[str, int]]]) -> None:
    """Refuse a condition in which all cameras always show the reference's own instant.

    Raises:
        ValueError: all cameras do so, although the condition is not the synchronized one.
    """
    if condition.name == SYNCED or any(set(moment.values()) != {instant} for instant, moment in shown):
        return
    if condition.drawn:
        raise ValueError(f"the frames are too far apart for offsets of up to {DISTINCT_MS[-1]:g} ms")
    raise ValueError("these cameras are equally late, which is synchronized")


def pair_instants(
    dataset: Dataset, condition: Condition, first: str, second: str
) -> tuple[list[tuple[int, int]], float | None]:
    """Return the pairs of instants (first camera's, second camera's) that a condition compares.

    Also returns the second camera's delay, ms; None if it is drawn for each instant.

    Raises:
        ValueError: both cameras have the same delay, or the burst has no images at such an offset.
    """
    offset = None if condition.drawn else _pair_offset(dataset, condition, first, second)
    pairs = offset.pairs if offset else _drawn_pairs(dataset, condition, first, second)
    if not (complete := pairs_with_images(dataset, pairs, first, second)):
        raise ValueError(f"{first} and {second} have no images at this offset")
    return complete, offset.actual_ms if offset else None


def _drawn_pairs(
    dataset: Dataset, condition: Condition, first: str, second: str
) -> Iterator[tuple[int, int]]:
    for instant in range(len(dataset.instants_ns)):
        with suppress(BadInputError):
            yield instant, instants_shown(dataset, condition.kept_at(first), instant)[second]


def _pair_offset(dataset: Dataset, condition: Condition, first: str, second: str) -> FrameOffset:
    late_ms = fixed_offsets_ms(condition, dataset)
    asked_ms = late_ms.get(second, 0.0) - late_ms.get(first, 0.0)
    if asked_ms == 0:
        raise ValueError(f"{first} and {second} are equally late, which is synchronized for these two")
    try:
        offset = nearest_frame_offset(dataset.instants_ns, dataset.period_ns, abs(asked_ms))
    except BadInputError as error:
        raise ValueError(str(error)) from error
    return offset if asked_ms > 0 else offset.reversed


def choose_moving_instants(
    motion: SceneMotion, cameras: Sequence[str], instants: Sequence[int], limit: int
) -> list[int]:
    """Return at most `limit` instants, spread evenly over those with motion in front of all cameras.

    All cameras must have an image at each instant. If nothing moves, the result is spread over all of them.
    """
    looked_at = evenly_spaced(instants, max(16, 4 * limit))
    shares = {k: min(float(motion.detected_moving(name, k).mean()) for name in cameras) for k in looked_at}
    moving = [k for k in looked_at if shares[k] >= MIN_MOVING]
    if len(moving) < min(MIN_INSTANTS, limit):
        busiest = sorted(looked_at, key=lambda k: -shares[k])[: min(MIN_INSTANTS, limit)]
        moving = sorted(k for k in busiest if shares[k] > 0)
    return evenly_spaced(moving or list(instants), limit)
