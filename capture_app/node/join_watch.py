"""Monitor of a join: logs why the leaders do not answer, and what slows the path to them."""

import asyncio
from collections.abc import Sequence

from capture_app.common.address import Address
from capture_app.net.reachability import Obstacle, find_obstacle
from capture_app.net.wifi import power_saving, power_saving_remedy, power_saving_towards
from capture_app.protocol.log import Log
from capture_app.sync.rig.time_client import TimeClient

LOOK_EVERY_S = 0.25
AGAIN_S = 10.0
UNANSWERED = 2
"""Number of unanswered hellos after which the path to the leaders is examined."""


class JoinWatch:
    """Check of the path to all leaders while none of them answers a node that asks to join."""

    def __init__(self, leaders: Sequence[Address], log: Log) -> None:
        self._leaders, self._log = tuple(leaders), log
        self._look_ahead: asyncio.Task[list[Obstacle | None]] | None = None

    def look_ahead(self) -> None:
        """Begin the first check now, because a camera may take seconds to open."""
        self._look_ahead = asyncio.create_task(self._look())

    async def run(self, time: TimeClient) -> None:
        """Watch until cancelled; `time` is the node's membership."""
        said, looked = "", False
        while True:
            if time.is_member:
                said, self._look_ahead = "", None
                if not looked:
                    looked = True
                    await self._look_at_wifi()
            if not _is_unanswered(time):
                await asyncio.sleep(LOOK_EVERY_S)
                continue
            ahead, self._look_ahead = self._look_ahead, None
            found = await (ahead or self._look())
            # What a leader has reported itself is already logged.
            obstacles = (obstacle for obstacle in found if obstacle and obstacle.what not in time.why_joining)
            sentence = "; ".join(map(str, obstacles))
            if _is_unanswered(time):
                if sentence and sentence != said:
                    self._log.say(sentence)
                    said = sentence
                await asyncio.sleep(AGAIN_S if said else LOOK_EVERY_S)

    async def _look(self) -> list[Obstacle | None]:
        return await asyncio.gather(*map(find_obstacle, self._leaders))

    async def _look_at_wifi(self) -> None:
        for leader in self._leaders:
            if interface := await asyncio.to_thread(power_saving_towards, leader.host):
                self._log.say(f"{power_saving(interface)}; {power_saving_remedy(interface)}")
                return


def _is_unanswered(time: TimeClient) -> bool:
    return not time.is_member and time.unanswered >= UNANSWERED
