"""What a study found, as `metrics.json` holds it: one form for depth, panoramas, points and poses."""

from typing import Generic, TypeVar

from msgspec import Struct


class Interval(Struct, frozen=True, kw_only=True):
    """A median over the instants, and the middle 95 % of its bootstrap over them; None with too few."""

    value: float
    low: float | None = None
    high: float | None = None

    @property
    def ends(self) -> tuple[float, float]:
        """Both ends; of no width where there were too few instants."""
        if self.low is None or self.high is None:
            return self.value, self.value
        return self.low, self.high


class Measure(Struct, frozen=True, kw_only=True):
    """One measure in both conditions; None where there was nothing to measure.

    `mover_*` counts pixels or points of moving things, `static_*` the control, which stands still.
    """

    name: str
    synced: Interval | None = None
    offset: Interval | None = None
    difference: Interval | None = None
    """Offset minus synced, paired by instant."""

    def side(self, side: str) -> Interval | None:
        """Its value in one condition: `synced` or `offset`."""
        return self.synced if side == "synced" else self.offset


class Picture(Struct, frozen=True, kw_only=True):
    """One picture of the comparison: paths relative to the output folder."""

    key: str
    title: str
    synced: str
    offset: str
    caption: str = ""
    panels: int = 1
    """Panels side by side within each file; a slider over more than one would mix them."""


class InstantClouds(Struct, frozen=True, kw_only=True):
    """The fused clouds of one instant: paths of PLY files in the rig's frame, and whence they are shown."""

    instant: int
    synced: str
    offset: str = ""
    """Empty where there is the synchronized one alone."""
    rotation: tuple[float, ...]
    """From the rig's frame to the reference camera's own, row by row."""
    centre: tuple[float, ...]
    """Where the reference camera stands."""
    focal: float
    """The reference camera's focal length over its pictures' width."""
    pivot: tuple[float, ...]
    """What a viewer turns about: the middle of what moves."""


Facts = TypeVar("Facts")


class StudyResult(Struct, Generic[Facts], frozen=True, kw_only=True):
    """What a study measured, synchronized and in another condition with all else equal, or why it did not."""

    name: str
    """The name of the study's plugin."""
    cameras: tuple[str, ...] = ()
    instants: int = 0
    offsets_ms: dict[str, float] = {}
    """How late each camera is against the first of a pair, else the reference; empty where each instant has
    delays of its own, and in pictures of one instant."""
    reason: str = ""
    """Why these cameras were taken, or why the study was made."""
    skipped: str = ""
    """Why nothing was measured; empty where something was."""
    unasked: bool = False
    """It was skipped because nobody asked for it."""
    measures: tuple[Measure, ...] = ()
    per_instant: tuple[dict[str, float | int | None], ...] = ()
    """`instant`, its facts, and each measure as `synced_*` and `offset_*`."""
    pictures: tuple[Picture, ...] = ()
    facts: Facts | None = None
    """Results that this study alone has, in a struct of its own: see docs/compare.md."""

    @property
    def pair(self) -> tuple[str, str]:
        """The cameras of a study of two."""
        first, second = self.cameras
        return first, second

    @property
    def late_ms(self) -> float | None:
        """How late the second camera of a pair is, where that is the same at every instant."""
        return self.offsets_ms.get(self.cameras[1])

    def interval(self, name: str, side: str = "synced") -> Interval | None:
        """A measure in one condition."""
        return next((one.side(side) for one in self.measures if one.name == name), None)

    def value(self, name: str, side: str = "synced") -> float | None:
        """The median of a measure in one condition."""
        found = self.interval(name, side)
        return None if found is None else found.value

    def first_known(self, *names: str) -> tuple[str, float, float] | None:
        """The first of these measures that both conditions have, and its values; None if there is none."""
        for name in names:
            before, after = self.value(name), self.value(name, "offset")
            if before is not None and after is not None:
                return name, before, after
        return None
