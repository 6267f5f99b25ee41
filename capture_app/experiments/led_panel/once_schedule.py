"""K messages, and no more: when the paper's phones ask for the time."""

from capture_app.sync.timekeeping.poll_schedule import NEVER_NS, Progress, SteadySchedule


class OnceSchedule(SteadySchedule):
    """Asks in quick succession until so many answers are there, and then never again."""

    def __init__(self, messages: int) -> None:
        super().__init__()
        self._messages = messages

    def request_sent(self, now_ns: int, progress: Progress) -> bool:
        """Note a request, and fix when the next is due."""
        report = super().request_sent(now_ns, progress)
        if progress.samples >= self._messages:
            self.request_due_ns = NEVER_NS
        return report

    def reply_arrived(self, now_ns: int, round_trip_ns: int, progress: Progress) -> bool:
        """Note a reply; whether the next request is to be sent at once."""
        at_once = super().reply_arrived(now_ns, round_trip_ns, progress)
        if progress.samples >= self._messages:
            self.request_due_ns = NEVER_NS
        return at_once and progress.samples < self._messages
