"""A schedule for models of what members and relays say, in which clocks play no part."""

from capture_app.sync.timekeeping.poll_schedule import NEVER_NS, SteadySchedule

S = 10**9


class Seldom(SteadySchedule):
    """One request a second and no estimate: the time is known, or not this model's."""

    def __init__(self) -> None:
        super().__init__(first_interval_ns=S, easing_intervals_ns=(), poll_interval_ns=S, near_ns=0)

    def estimated(self, now_ns: int, *, is_settled: bool) -> None:
        self.estimate_due_ns = NEVER_NS
