"""Interface for other programs that follow a rig's takes: entry points of `simulshot.followers`.

Each names a module with `OPTIONS` (click's, of the command `leader`) and `make_followers`. A leader starts
and closes its followers, and knows nothing else of them.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from capture_app.common.clock import NodeClock
from capture_app.common.plugins import load_plugins
from capture_app.node.burst.burst_session import BurstSession

GROUP = "simulshot.followers"


class Follower(Protocol):
    """Another program that follows the takes of a rig."""

    def start(self, clock: NodeClock) -> None:
        """Begin, with the leader's clock. Raises SimulshotError if that is not possible."""

    def follow_take(self, take: BurstSession) -> None:
        """Follow a take that has begun."""

    async def close(self) -> None:
        """Release the program. Calling it twice is harmless."""


def make_followers(values: Mapping[str, Any]) -> Sequence[Follower]:
    """Make the followers that the options' `values` ask for."""
    plugins = load_plugins(GROUP, "OPTIONS", "make_followers").values()
    return [follower for plugin in plugins for follower in plugin.make_followers(values)]
