"""Says by itself why the leaders of a node or a relay do not answer, and what makes the way to them slow."""

import asyncio
from collections.abc import Callable, Sequence

from capture_app.net.address import Address
from capture_app.net.reach import find_obstacle
from capture_app.net.wifi import power_saving, power_saving_remedy, power_saving_towards
from capture_app.sync.rig.time_client import TimeClient

LOOK_EVERY_S = 0.25
AGAIN_S = 10.0
UNANSWERED = 2
"""So many hellos without an answer, and the way to the leaders is looked into."""


class JoinWatch:
    """Looks into the way to all leaders while none of them says anything to a node that asks to join."""

    def __init__(self, leaders: Sequence[Address], time: TimeClient, tell: Callable[[str], None]) -> None:
        """`time` is the node's membership; `tell` gets a sentence when there is a new one."""
        self._leaders, self._time, self._tell = tuple(leaders), time, tell

    async def run(self) -> None:
        """Watch until cancelled."""
        said, looked = "", False
        while True:
            if self._time.is_member:
                said = ""
                if not looked:
                    looked = True
                    await self._look_at_wifi()
            if not self._is_unanswered:
                await asyncio.sleep(LOOK_EVERY_S)
                continue
            found = await asyncio.gather(*map(find_obstacle, self._leaders))
            # What a leader has said itself is told already.
            news = (
                obstacle for obstacle in found if obstacle and obstacle.what not in self._time.why_joining
            )
            sentence = "; ".join(map(str, news))
            if self._is_unanswered:
                if sentence and sentence != said:
                    self._tell(sentence)
                    said = sentence
                await asyncio.sleep(AGAIN_S if said else LOOK_EVERY_S)

    async def _look_at_wifi(self) -> None:
        for leader in self._leaders:
            if interface := await asyncio.to_thread(power_saving_towards, leader.host):
                self._tell(f"{power_saving(interface)}; {power_saving_remedy(interface)}")
                return

    @property
    def _is_unanswered(self) -> bool:
        return not self._time.is_member and self._time.unanswered >= UNANSWERED
