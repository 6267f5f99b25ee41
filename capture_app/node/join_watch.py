"""Says by itself why the leaders of a node or a relay do not answer, as long as they do not."""

import asyncio
from collections.abc import Callable, Sequence

from capture_app.net.address import Address
from capture_app.net.reach import find_obstacle
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
        said = ""
        while True:
            if not self._is_unanswered:
                said = ""
                await asyncio.sleep(LOOK_EVERY_S)
                continue
            found = await asyncio.gather(*map(find_obstacle, self._leaders))
            sentence = "; ".join(str(obstacle) for obstacle in found if obstacle is not None)
            if self._is_unanswered:
                if sentence and sentence != said:
                    self._tell(sentence)
                    said = sentence
                await asyncio.sleep(AGAIN_S if said else LOOK_EVERY_S)

    @property
    def _is_unanswered(self) -> bool:
        return not self._time.is_member and self._time.unanswered >= UNANSWERED
