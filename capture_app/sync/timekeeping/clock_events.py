"""Events of a node's clock that the engine reports to its caller; they are never sent over the network."""

from dataclasses import dataclass

from capture_app.sync.clock.time_map import TimeMap


@dataclass(frozen=True, slots=True)
class ClockSynced:
    """The leader's clock is known as accurately as requested, or as accurately as the link allows."""

    time_map: TimeMap
    """Map from the local clock to the root's."""


@dataclass(frozen=True, slots=True)
class ClockChanged:
    """One of the two clocks changed: it stepped, which restarts the estimate, or its rate changed.

    Another program has started or stopped correcting that clock.
    """

    jumped: bool


@dataclass(frozen=True, slots=True)
class StepRefused:
    """Samples that suggested a clock step were rejected, because later samples did not confirm it."""

    times: int
    """Number of such steps since the last report."""


@dataclass(frozen=True, slots=True)
class ClockRateUnusual:
    """This node's clock and the leader's differ in rate by more than two ordinary crystals do."""

    fast_ppm: float | None
    """Rate excess of this node's clock; None if the rate is ordinary again."""


@dataclass(frozen=True, slots=True)
class TimesDoubted:
    """Times of an interval of this node's clock were wrong, and their error is known now; all in ns.

    After a sleep of the machine it is empty: times are right before and after, by different maps.
    """

    from_local_ns: int
    until_local_ns: int
    error_ns: int
    """95 % error of the times that were given in the interval, by the newest map."""
    hard_bound_ns: int
    """Largest error, by that map's hard bound."""
    jumped: bool
    """Whether a clock stepped; otherwise its rate changed."""


ClockEvent = ClockChanged | StepRefused | ClockSynced | ClockRateUnusual | TimesDoubted
