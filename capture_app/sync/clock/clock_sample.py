"""One exchange of two time messages, and the bounds on the clock offset that it gives."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ClockSample:
    """One exchange, in ns: t0 client sends, t1 leader receives, t2 leader sends, t3 client receives.

    t0 and t3 are read off the client's local clock, t1 and t2 off the leader's.
    """

    t0_ns: int
    t1_ns: int
    t2_ns: int
    t3_ns: int

    @property
    def round_trip_ns(self) -> int:
        """Time spent on the way, both directions together, in ns."""
        return (self.t3_ns - self.t0_ns) - (self.t2_ns - self.t1_ns)

    @property
    def lower_ns(self) -> int:
        """Leader minus local time is at least this at t3, in ns."""
        return self.t2_ns - self.t3_ns

    @property
    def upper_ns(self) -> int:
        """Leader minus local time is at most this at t0, in ns."""
        return self.t1_ns - self.t0_ns

    @property
    def local_ns(self) -> int:
        """Middle of the exchange in local time, in ns."""
        return (self.t0_ns + self.t3_ns) // 2
