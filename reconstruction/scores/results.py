"""What all results of a comparison are made of."""

from msgspec import Struct


class Interval(Struct, frozen=True, kw_only=True):
    """A value and the middle 95 % of its bootstrap over the instants."""

    value: float
    low: float
    high: float


class Picture(Struct, frozen=True, kw_only=True):
    """One picture of the comparison: paths relative to the output folder."""

    key: str
    title: str
    synced: str
    offset: str
    caption: str = ""
    panels: int = 1
    """Panels side by side within each file; a slider over more than one would mix them."""
