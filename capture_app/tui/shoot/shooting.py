"""The course of a take: countdown, then once, every so often or one after the other, until it is stopped."""

import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from itertools import count

from capture_app.tui.shoot.plan import TakeMode, TakePlan


@dataclass(frozen=True, slots=True)
class Moment:
    """What is under way: a countdown or a pause of so many seconds, or a take; and which take it is."""

    number: int
    total: int
    seconds: int = 0
    """Left until the take; 0 while it is taken."""

    def __str__(self) -> str:
        """Return it in words."""
        of = f"take {self.number} of {self.total}" if self.total > 1 else "the take"
        return f"{of} in {self.seconds} s" if self.seconds else f"{of} is being taken"


class Shooting:
    """Takes as planned. `take` orders a burst; its event is set when that is saved or has failed."""

    def __init__(
        self,
        take: Callable[[], asyncio.Event],
        show: Callable[[Moment], None],
        *,
        now: Callable[[], float],
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        """`now` and `sleep`: seconds."""
        self._take, self._show = take, show
        self._now, self._sleep = now, sleep

    async def run(self, plan: TakePlan) -> None:
        """Take as planned, and return when the last take is ordered.

        An interval does not wait for the take before to be saved.
        """
        total = plan.takes if plan.mode in (TakeMode.INTERVAL, TakeMode.SEQUENCE) else 1
        due = self._now() + plan.countdown_s
        for number in count(1):
            await self._wait(due, number, total)
            self._show(Moment(number, total))
            done = self._take()
            if number == total:
                return
            if plan.mode is TakeMode.INTERVAL:
                due += plan.every_s
            else:
                await done.wait()
                due = self._now() + plan.countdown_s

    async def _wait(self, due: float, number: int, total: int) -> None:
        while (left := due - self._now()) > 0:
            seconds = math.ceil(left)
            self._show(Moment(number, total, seconds))
            # Until the next whole second, so that the number on the screen changes when it is told.
            await self._sleep(max(left - (seconds - 1), 0.001))
