"""The rig's time on a machine that is not a member of it: bounds from requests to the leader, and marks.

The leader reads its clock between a request and its answer, so the two bound the difference of the clocks,
whatever the delay in either direction. Several requests are sent, and the tightest bounds count. As with AWS
ClockBound, a time is an interval: the earliest and the latest possible.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from msgspec import Struct

from capture_app.common import system
from capture_app.common.address import Address
from capture_app.net.asking import ask
from capture_app.net.channel import Channel, connect
from capture_app.protocol import messages, orders
from capture_app.session.format.marks import Mark, check_mark_text
from capture_app.sync.clock.likely_line import MAX_SKEW

EXCHANGES = 8


@dataclass(frozen=True, slots=True)
class LeaderTime:
    """Time of a rig at a moment: its leader's clock showed something from `earliest_ns` to `latest_ns`.

    Both are ns of the clock that sessions have as `leader_ns`.
    """

    earliest_ns: int
    latest_ns: int
    local_ns: int
    """This machine's `time.perf_counter_ns()` at that moment."""
    unix_less_leader_ns: int
    """Difference of the leader's wall clock (Unix time) and its own clock, ns."""

    @property
    def leader_ns(self) -> int:
        """Middle of the two, ns."""
        return (self.earliest_ns + self.latest_ns) // 2

    @property
    def uncertainty_ns(self) -> int:
        """Maximum error of `leader_ns`, ns."""
        return self.latest_ns - self.leader_ns

    def at(self, local_ns: int) -> "LeaderTime":
        """Return the rig's time at another `time.perf_counter_ns()`, as far as clocks may drift."""
        elapsed_ns = local_ns - self.local_ns
        drift_ns = int(abs(elapsed_ns) * MAX_SKEW) + 1
        return LeaderTime(
            self.earliest_ns + elapsed_ns - drift_ns,
            self.latest_ns + elapsed_ns + drift_ns,
            local_ns,
            self.unix_less_leader_ns,
        )


class PlacedMark(Struct, frozen=True, kw_only=True):
    """A mark, and the names of the sessions that it was stored in; of none if no take was under way."""

    mark: Mark
    sessions: tuple[str, ...]
    file: str
    """Path of the file on the leader's machine that has it instead; empty if it is in a session."""


async def read_rig_time(
    channel: Channel[Any], exchanges: int = EXCHANGES, now_ns: Callable[[], int] = system.monotonic_ns
) -> LeaderTime:
    """Return the rig's time now, by exchanges over an open stream.

    Raises NetworkError, and the leader's errors.
    """
    best: LeaderTime | None = None
    for _ in range(exchanges):
        asked_ns = now_ns()
        answer = await ask(channel, orders.AskTime(), orders.TimeAnswer)
        local_ns = now_ns()
        time_now = LeaderTime(
            answer.leader_ns,
            answer.leader_ns + local_ns - asked_ns,
            local_ns,
            answer.unix_ns - answer.leader_ns,
        )
        if best is not None:
            before = best.at(local_ns)
            earliest_ns = max(time_now.earliest_ns, before.earliest_ns)
            latest_ns = min(time_now.latest_ns, before.latest_ns)
            # They exclude each other only if a clock was set or the machine slept meanwhile.
            if earliest_ns <= latest_ns:
                time_now = LeaderTime(earliest_ns, latest_ns, local_ns, time_now.unix_less_leader_ns)
        best = time_now
    assert best is not None, "there is at least one exchange"
    return best


async def rig_time(leader: Address) -> LeaderTime:
    """Return the time of a leader's rig now. Raises NetworkError, UnknownMachineError without the right."""
    async with await connect(leader, messages.FromLeader) as channel:
        return await read_rig_time(channel)


async def place_mark(leader: Address, text: str, local_ns: int | None = None) -> PlacedMark:
    """Note an event in the take under way; its time is the call's, however long the leader takes.

    `local_ns`: the event's `time.perf_counter_ns()` on this machine, if it was earlier. Raises BadInputError
    for a text that is empty or too long, NetworkError, and UnknownMachineError without the right.
    """
    called_ns = system.monotonic_ns() if local_ns is None else local_ns
    check_mark_text(text)
    async with await connect(leader, messages.FromLeader) as channel:
        now = (await read_rig_time(channel)).at(called_ns)
        mark = Mark(text=text, leader_ns=now.leader_ns, uncertainty_ns=now.uncertainty_ns)
        placed = await ask(channel, orders.PlaceMark(mark=mark), orders.MarkPlaced)
    return PlacedMark(mark=mark, sessions=placed.sessions, file=placed.file)
