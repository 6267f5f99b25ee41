"""Conditions of a comparison or a batch: each camera's time offset, and the frames that it selects."""

import math
import random
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, TypeVar

from capture_app.common.errors import BadInputError
from capture_app.common.instants import is_same_instant
from capture_app.session.format.camera_labels import require_camera

if TYPE_CHECKING:
    from reconstruction.scene.dataset import Dataset

SYNCED = "synced"
DISTINCT = "distinct"
DISTINCT_MS = (-66.0, -33.0, 0.0, 33.0, 66.0)
"""Offsets of the paper's unsynchronized cameras: up to two frames at 30 fps, in either direction."""
MAX_OFFSET_MS = 1e6
"""Maximum delay that a condition may have."""


@dataclass(frozen=True)
class Condition:
    """Delay of each camera's images: zero, drawn at random, or as listed (ms)."""

    name: str
    listed_ms: tuple[float, ...] = ()
    """One number: the delay of every second camera; else one for each camera, in the session's order."""
    named_ms: tuple[tuple[str, float], ...] = ()
    """Delays by camera; cameras that are not named have none."""
    anchor: str = ""
    """Camera that shows the instant itself, as delays count from its own; empty: they count from the instant.

    Drawn delays are then drawn until the burst has all their images.
    """

    @classmethod
    def parse(cls, text: str) -> "Condition":
        """Parse `synced`, `distinct`, `MS` (every second camera), `MS,MS,...` or `CAMERA=MS,CAMERA=MS,...`.

        `@CAMERA` after it names the `anchor`.

        Raises:
            BadInputError: the text is none of these.
        """
        text, at, anchor = text.strip().partition("@")
        if at:
            return cls.parse(text).kept_at(anchor.strip())
        if text in (SYNCED, DISTINCT):
            return cls(text)
        parts = [part.rpartition("=") for part in text.split(",")]
        cameras = [camera.strip() for camera, _, _ in parts]
        by_name = all(cameras) and len(set(cameras)) == len(cameras)
        try:
            late_ms = [float(number) for _, _, number in parts]
        except ValueError:
            late_ms = [math.nan]
        mixed = not by_name and any(equals for _, equals, _ in parts)
        if mixed or not all(abs(ms) < MAX_OFFSET_MS for ms in late_ms):
            raise BadInputError(
                f"{text!r} is not a condition",
                hint=f"{SYNCED}, {DISTINCT}, 66, a number for each camera such as 0,66, or cam00=0,cam01=66",
            )
        if not by_name:
            return cls("_".join(f"{ms:g}" for ms in late_ms) + "ms", listed_ms=tuple(late_ms))
        named = tuple(zip(cameras, late_ms, strict=True))
        return cls("_".join(f"{camera}={ms:g}" for camera, ms in named) + "ms", named_ms=named)

    def kept_at(self, camera: str) -> "Condition":
        """Return the condition in which a camera shows the instant itself; the synchronized one stays."""
        name = self.name.partition("@")[0]
        return self if name == SYNCED else replace(self, name=f"{name}@{camera}", anchor=camera)

    @property
    def option(self) -> str:
        """The text that `parse` reads."""
        listed = ",".join(f"{ms:g}" for ms in self.listed_ms)
        named = ",".join(f"{camera}={ms:g}" for camera, ms in self.named_ms)
        text = listed or named or (DISTINCT if self.drawn else SYNCED)
        return f"{text}@{self.anchor}" if self.anchor else text

    @property
    def drawn(self) -> bool:
        """Whether offsets are drawn separately for every instant."""
        return self.name.partition("@")[0] == DISTINCT

    def offsets_ms(self, cameras: Sequence[str], instant: int, draw: int = 0) -> tuple[float, ...]:
        """Return each camera's delay, ms; empty if all are synchronized.

        Drawn delays depend only on the instant and the number of the draw. They all differ if possible:
        cameras with equal offsets agree with each other and hide the effect.
        """
        offsets = self._offsets_ms(cameras, instant, draw)
        if not self.anchor or not offsets:
            return offsets
        own_ms = offsets[cameras.index(self.anchor)]
        return tuple(ms - own_ms for ms in offsets)

    def _offsets_ms(self, cameras: Sequence[str], instant: int, draw: int) -> tuple[float, ...]:
        if self.drawn:
            source = random.Random(f"{DISTINCT} {instant}" + (f" {draw}" if draw else ""))
            rounds = -(-len(cameras) // len(DISTINCT_MS))
            return tuple(ms for _ in range(rounds) for ms in source.sample(DISTINCT_MS, 5))[: len(cameras)]
        if self.named_ms:
            return tuple(dict(self.named_ms).get(camera, 0.0) for camera in cameras)
        if len(self.listed_ms) == 1:
            return tuple(self.listed_ms[0] * (place % 2) for place in range(len(cameras)))
        return self.listed_ms

    def named(self, dataset: "Dataset") -> "Condition":
        """Return the condition with the names of the cameras that it means.

        Raises:
            BadInputError: it names unknown cameras, or has more or fewer.
        """
        if len(self.listed_ms) > 1:
            dataset.require_offset_each(self.listed_ms)
        names = {
            text: require_camera(text, dataset.labels, "--condition")
            for text in (*dict(self.named_ms), self.anchor)
            if text
        }
        named_ms = tuple((names[text], ms) for text, ms in self.named_ms)
        return replace(self, named_ms=named_ms, anchor=names.get(self.anchor, ""))


SYNCHRONIZED, ALL_APART = Condition(SYNCED), Condition(DISTINCT)
Item = TypeVar("Item")


@dataclass(frozen=True)
class FrameOffset:
    """A time offset between instants of a burst, and the pairs of instants with this offset."""

    asked_ms: float
    actual_ns: int
    frames: int
    """The offset in frames of the cameras."""
    step: int
    """The offset in instants of the burst, if these are evenly spaced."""
    pairs: tuple[tuple[int, int], ...]
    """(instant, the instant that is `actual_ns` later)."""

    @property
    def reversed(self) -> "FrameOffset":
        """The same offset in the other direction: the second of each pair is earlier."""
        return replace(
            self,
            asked_ms=-self.asked_ms,
            actual_ns=-self.actual_ns,
            frames=-self.frames,
            pairs=tuple((later, now) for now, later in self.pairs),
        )

    @property
    def actual_ms(self) -> float:
        """The actual offset in the burst, ms."""
        return self.actual_ns / 1e6


def nearest_frame_offset(instants_ns: Sequence[int], period_ns: int, offset_ms: float) -> FrameOffset:
    """Return the offset between instants of the burst that is nearest to the requested one.

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
    if not is_same_instant(nearest - asked_ns, spacing):
        raise BadInputError(
            f"no two frames of the burst are about {offset_ms:g} ms apart",
            hint=f"the nearest offset possible is {nearest / 1e6:.1f} ms",
        )
    pairs = tuple(
        (i, j)
        for i, a in enumerate(instants_ns)
        for j, b in enumerate(instants_ns)
        if abs(b - a - nearest) <= spacing / 4
    )
    return FrameOffset(
        offset_ms, nearest, round(nearest / period_ns), max(1, round(nearest / spacing)), pairs
    )


def pairs_with_images(
    dataset: "Dataset", pairs: Iterable[tuple[int, int]], reference: str, other: str
) -> list[tuple[int, int]]:
    """Return the pairs of different instants for which both conditions have all their images."""
    return [
        (now, later)
        for now, later in pairs
        if later != now and dataset.has_images(((reference, now), (other, now), (other, later)))
    ]


def evenly_spaced(items: Sequence[Item], limit: int) -> list[Item]:
    """Return at most `limit` items, evenly spread; a single one from the middle."""
    if len(items) <= limit:
        return list(items)
    if limit == 1:
        return [items[len(items) // 2]]
    step = (len(items) - 1) / (limit - 1)
    return [items[round(i * step)] for i in range(limit)]
