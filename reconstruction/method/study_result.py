"""Result of a study as `metrics.json` stores it: one format for depth, panoramas, points and poses."""

from typing import Generic, TypeVar

from msgspec import Struct


class Interval(Struct, frozen=True, kw_only=True):
    """A median over the instants, with a 95 % bootstrap interval; its ends are None with too few instants."""

    value: float
    low: float | None = None
    high: float | None = None

    @property
    def ends(self) -> tuple[float, float]:
        """Both ends of the interval; equal to the value if there were too few instants."""
        return (self.value, self.value) if self.low is None or self.high is None else (self.low, self.high)


class Measure(Struct, frozen=True, kw_only=True):
    """One measure in both conditions; None if nothing could be measured.

    Names that begin with `mover_` are of pixels or points on moving objects, those with `static_` of the
    control.
    """

    name: str
    synced: Interval | None = None
    offset: Interval | None = None
    difference: Interval | None = None
    """Offset minus synced, paired by instant."""

    def side(self, side: str) -> Interval | None:
        """Return the measure's value in one condition: `synced` or `offset`."""
        return self.synced if side == "synced" else self.offset


class Picture(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One picture of the comparison; paths are relative to the output folder."""

    key: str
    title: str
    synced: str = ""
    offset: str = ""
    caption: str = ""
    panels: int = 1
    """Number of panels side by side in each file; a slider across several panels would mix them."""


Facts = TypeVar("Facts")


class StudyResult(Struct, Generic[Facts], frozen=True, kw_only=True):
    """Measurements of a study, synchronized and in another condition; or why it was skipped."""

    name: str
    """Name of the study's plugin."""
    cameras: tuple[str, ...] = ()
    instants: int = 0
    offsets_ms: dict[str, float] = {}
    """Delay of each camera against the first of a pair, else against the reference.

    Empty if each instant has its own delays, and for images of one instant.
    """
    reason: str = ""
    """Why these cameras were chosen, or why the study was made."""
    skipped: str = ""
    """Why nothing was measured; empty if something was."""
    unasked: bool = False
    """Whether it was skipped because it was not requested."""
    failed: bool = False
    """Whether it was skipped because of a bug."""
    commands: dict[str, str] = {}
    """Command line, by condition, that writes the files whose score the measures are; empty for a check."""
    measures: tuple[Measure, ...] = ()
    per_instant: tuple[dict[str, float | int | None], ...] = ()
    """Rows with `instant`, its facts, and each measure as `synced_*` and `offset_*`."""
    pictures: tuple[Picture, ...] = ()
    facts: Facts = None  # type: ignore[assignment]
    """Results that only this study has, in a struct of its own: see docs/metrics.md. None if it has none."""

    @property
    def late_ms(self) -> float | None:
        """Delay of a pair's second camera; None if it differs between instants."""
        return self.offsets_ms.get(self.cameras[1])

    def interval(self, name: str, side: str = "synced") -> Interval | None:
        """Return a measure's interval in one condition; None if it was not measured."""
        return next((measure.side(side) for measure in self.measures if measure.name == name), None)

    def value(self, name: str, side: str = "synced") -> float | None:
        """Return a measure's median in one condition; None if it was not measured."""
        interval = self.interval(name, side)
        return None if interval is None else interval.value

    def first_known(self, *names: str) -> tuple[str, float, float] | None:
        """Return the first measure that both conditions have, with both values; None if there is none."""
        values = ((name, self.value(name), self.value(name, "offset")) for name in names)
        return next(((name, a, b) for name, a, b in values if a is not None and b is not None), None)
