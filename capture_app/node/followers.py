"""Interface for other programs that follow a rig's frame grid: entry points of `simulshot.followers`.

Each names a module with `OPTIONS` (click's, of the command `leader`) and `make_followers`. A leader starts
and closes its followers, and knows nothing else of them.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from capture_app.common.clock import NodeClock
from capture_app.common.plugins import load_plugins
from capture_app.node.burst.burst_session import BurstSession
from capture_app.protocol.log import Log
from capture_app.protocol.messages import BurstRequest
from capture_app.protocol.status import FollowerStatus

GROUP = "simulshot.followers"


class Follower:
    """Other programs of one kind that follow a started rig; this base class takes no pictures."""

    grid: tuple[int, int] | None = None
    """Period and phase (ns) of the grid that the rig must use; None: they follow any grid."""

    def start(self, clock: NodeClock, event_log: Log) -> None:
        """Lead the programs and log their events. Raises NetworkError where a port of theirs is in use."""
        raise NotImplementedError

    async def close(self) -> None:
        """Release the programs. Calling it twice is harmless."""
        raise NotImplementedError

    def take_part(self, take: BurstSession) -> None:
        """Let capable programs take their part of a burst."""

    def take_alone(self, request: BurstRequest) -> str:
        """Let connected programs take a burst in a rig without cameras; return a summary, empty without them.

        Raises BadInputError for a recording without an end.
        """
        return ""

    def expose(self, exposure_ns: int, iso: int) -> None:
        """Set the exposure (ns) and ISO of every frame; programs that cannot do so ignore it."""

    def statuses(self) -> tuple[FollowerStatus, ...]:
        """Return the devices that are or recently were connected."""
        return ()


def make_followers(host: str, values: Mapping[str, Any], *, leads: bool = False) -> Sequence[Follower]:
    """Make the followers that the options' `values` ask for.

    `host` is the address that the rig listens on; with `leads`, a follower may require its own grid.
    """
    plugins = load_plugins(GROUP, "OPTIONS", "make_followers").values()
    made = [plugin.make_followers(host, values, leads=leads) for plugin in plugins]
    return [follower for followers in made for follower in followers]
