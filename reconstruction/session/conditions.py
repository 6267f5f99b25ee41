"""Conditions of a comparison or a batch as data: how late each camera's picture is."""

import math
import random
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from capture_app.errors import BadInputError
from reconstruction.session.dataset import Dataset
from reconstruction.session.frame_offset import FrameOffset, nearest_frame_offset, pairs_with_images

SYNCED = "synced"
DISTINCT = "distinct"
DISTINCT_MS = (-66.0, -33.0, 0.0, 33.0, 66.0)
"""What the paper's unsynchronized cameras are off by: up to two frames of 30 a second, either way."""
MOST_DRAWS = 400
MOST_MS = 1e6


@dataclass(frozen=True)
class Condition:
    """How the cameras' pictures are apart in time: together, drawn at random, or listed (ms)."""

    name: str
    listed_ms: tuple[float, ...] = ()
    """One number: every second camera is so late; else one for each camera, in the session's order."""
    named_ms: tuple[tuple[str, float], ...] = ()
    """By camera; one that is not named is on time."""

    @classmethod
    def parse(cls, text: str) -> "Condition":
        """`synced`; `distinct`; `MS`: every second camera so late; `MS,MS,...`; `CAMERA=MS,CAMERA=MS,...`.

        Raises:
            BadInputError: it is none of these.
        """
        text = text.strip()
        if text in (SYNCED, DISTINCT):
            return cls(text)
        parts = [part.rpartition("=") for part in text.split(",")]
        cameras = [camera.strip() for camera, _, _ in parts]
        by_name = all(cameras) and len(set(cameras)) == len(cameras)
        try:
            late_ms = [float(number) for _, _, number in parts]
        except ValueError:
            late_ms = [math.nan]
        one_way = by_name or not any(equals for _, equals, _ in parts)
        if not one_way or not all(abs(ms) < MOST_MS for ms in late_ms):
            raise BadInputError(
                f"{text!r} is no condition",
                hint=f"{SYNCED}, {DISTINCT}, 66, one number for each camera, or cam00=0,cam01=66",
            )
        if not by_name:
            return cls("_".join(f"{ms:g}" for ms in late_ms) + "ms", listed_ms=tuple(late_ms))
        named = tuple(zip(cameras, late_ms, strict=True))
        return cls("_".join(f"{camera}={ms:g}" for camera, ms in named) + "ms", named_ms=named)

    @property
    def drawn(self) -> bool:
        """Whether every instant has offsets of its own."""
        return self.name == DISTINCT

    def offsets_ms(self, cameras: Sequence[str], instant: int, draw: int = 0) -> tuple[float, ...]:
        """How late each camera is, ms; none for all together.

        Drawn ones depend on the instant and the number of the draw only, and are all different as long as
        there are enough of them: cameras that share an offset agree with each other and hide what it does.
        """
        if self.drawn:
            source = random.Random(f"{DISTINCT} {instant}" + (f" {draw}" if draw else ""))
            rounds = -(-len(cameras) // len(DISTINCT_MS))
            return tuple(ms for _ in range(rounds) for ms in source.sample(DISTINCT_MS, 5))[: len(cameras)]
        if self.named_ms:
            named = dict(self.named_ms)
            return tuple(named.get(camera, 0.0) for camera in cameras)
        if len(self.listed_ms) == 1:
            return tuple(self.listed_ms[0] * (place % 2) for place in range(len(cameras)))
        return self.listed_ms

    def check(self, dataset: Dataset) -> None:
        """Refuse a list that does not fit the session's cameras.

        Raises:
            BadInputError: it names others, or has more or fewer.
        """
        for name, _ in self.named_ms:
            dataset.session.camera(name)
        if len(self.listed_ms) > 1 and len(self.listed_ms) != len(dataset.cameras):
            raise BadInputError(
                f"{len(self.listed_ms)} offsets for {len(dataset.cameras)} cameras",
                hint=f"give one for each, in this order: {', '.join(dataset.cameras)}",
            )


def fixed_offsets_ms(condition: Condition, dataset: Dataset) -> dict[str, float]:
    """How late each camera is in every instant, ms; empty where that is drawn anew for each."""
    offsets = () if condition.drawn else condition.offsets_ms(dataset.cameras, 0)
    return dict(zip(dataset.cameras, offsets, strict=False))


def instants_shown(dataset: Dataset, condition: Condition, reference: str, instant: int) -> dict[str, int]:
    """The instant that each camera shows when the reference shows `instant`.

    Only the differences of a condition's offsets can be seen; this way the reference's own picture, and
    all that is judged on its pixels, is the same in every condition. Offsets are drawn until they fit
    into the burst.

    Raises:
        ValueError: the burst does not reach so far to either side of this instant.
    """
    place = dataset.cameras.index(reference)
    for draw in range(MOST_DRAWS if condition.drawn else 1):
        offsets = condition.offsets_ms(dataset.cameras, instant, draw)
        try:
            return dataset.shown_instants(instant, [ms - offsets[place] for ms in offsets])
        except BadInputError as error:
            problem = str(error)
    if condition.drawn:
        problem = f"the burst is too short to draw different offsets around instant {instant}"
    raise ValueError(problem)


def refuse_synchronized(condition: Condition, shown: Iterable[tuple[int, Mapping[str, int]]]) -> None:
    """Refuse a condition in which all cameras show the reference's own instant, each time.

    Raises:
        ValueError: they do, although it is not the synchronized one.
    """
    if condition.name == SYNCED or any(set(one.values()) != {instant} for instant, one in shown):
        return
    if condition.drawn:
        raise ValueError(f"the frames are too far apart for offsets of up to {DISTINCT_MS[-1]:g} ms")
    raise ValueError("these cameras are equally late, which is synchronized")


def pair_instants(
    dataset: Dataset, condition: Condition, first: str, second: str
) -> tuple[list[tuple[int, int]], float | None]:
    """The instants (the first camera's, the second's) at which a pair has its pictures in a condition.

    And how late the second camera is, ms; None where every instant is drawn for itself.

    Raises:
        ValueError: both are equally late, or the burst does not hold such an offset.
    """
    found: list[tuple[int, int]] = []
    if condition.drawn:
        for instant in range(len(dataset.instants_ns)):
            try:
                later = instants_shown(dataset, condition, first, instant)[second]
            except ValueError:
                continue
            if later == instant:
                continue
            if dataset.has_images(((first, instant), (second, instant), (second, later))):
                found.append((instant, later))
        late_ms = None
    else:
        offset = _pair_offset(dataset, condition, first, second)
        found, late_ms = pairs_with_images(dataset, offset, first, second), offset.actual_ms
    if not found:
        raise ValueError(f"{first} and {second} have no images at this offset")
    return found, late_ms


def _pair_offset(dataset: Dataset, condition: Condition, first: str, second: str) -> FrameOffset:
    late_ms = fixed_offsets_ms(condition, dataset)
    asked_ms = late_ms.get(second, 0.0) - late_ms.get(first, 0.0)
    if asked_ms == 0:
        raise ValueError(f"{first} and {second} are equally late, which is synchronized for these two")
    try:
        found = nearest_frame_offset(dataset.instants_ns, dataset.period_ns, abs(asked_ms))
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
