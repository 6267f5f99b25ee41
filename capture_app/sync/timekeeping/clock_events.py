"""What happens to a node's clock, as the engine tells it; facts, which never leave the process."""

from dataclasses import dataclass

from capture_app.sync.clock.time_map import TimeMap


@dataclass(frozen=True, slots=True)
class ClockSynced:
    """The leader's clock is known as well as was asked for, or as well as the link allows."""

    time_map: TimeMap
    """From the local clock to the root's."""


@dataclass(frozen=True, slots=True)
class ClockChanged:
    """One of the two clocks changed: it jumped, so that the estimate starts anew, or runs at another rate.

    Somebody is correcting it then, or has just ceased to.
    """

    jumped: bool


@dataclass(frozen=True, slots=True)
class StepRefused:
    """Some answers told of a step of a clock, and those after them did not: they were not believed."""

    times: int
    """How often, since this was told last."""


@dataclass(frozen=True, slots=True)
class WayLonger:
    """Messages in one direction take longer than they did, by load or by malice; or as before again."""

    longer_ns: float
    """By how much; 0 for as before."""


@dataclass(frozen=True, slots=True)
class ClockRateUnusual:
    """This node's clock and the leader's differ in rate by more than two ordinary crystals do."""

    fast_ppm: float | None
    """By how much this node's clock is faster; None where it is no more than usual again."""


ClockEvent = ClockChanged | StepRefused | ClockSynced | WayLonger | ClockRateUnusual
