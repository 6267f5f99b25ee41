"""What happens to a node's clock, as the engine tells it; facts, which never leave the process."""

from dataclasses import dataclass

from capture_app.sync.clock.time_map import TimeMap


@dataclass(frozen=True, slots=True)
class ClockSynced:
    """The leader's clock is known as well as was asked for, or as well as the link allows."""

    time_map: TimeMap
    """From the local clock to the root's."""


@dataclass(frozen=True, slots=True)
class ClockStepped:
    """One of the clocks jumped; the estimate starts anew."""


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

    fast_ppm: float
    """By how much this node's clock is faster."""


@dataclass(frozen=True, slots=True)
class ClockRateUsual:
    """They differ by no more than is usual any more."""


@dataclass(frozen=True, slots=True)
class ClockRateChanged:
    """The rate of one of the two clocks changed: somebody is correcting it, or has just ceased to."""


@dataclass(frozen=True, slots=True)
class ReferenceCorrectionStarted:
    """The clock is being moved to where all agree that hear the same beacons."""

    relative_uncertainty_ns: int
    """95 % error of this clock against those of the others, in ns."""


@dataclass(frozen=True, slots=True)
class ReferenceCorrectionEnded:
    """Nothing was agreed for long: the clock is again what the leader's answers alone tell."""


ClockEvent = (
    ClockStepped
    | StepRefused
    | ClockSynced
    | WayLonger
    | ClockRateUnusual
    | ClockRateUsual
    | ClockRateChanged
    | ReferenceCorrectionStarted
    | ReferenceCorrectionEnded
)
