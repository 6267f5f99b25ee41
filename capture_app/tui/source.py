"""What the screen needs of a rig: snapshots to show, and the few things a user can ask for."""

from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from capture_app.node.wire.status import BurstStatus, RigStatus
from capture_app.text import ProgressStep


@dataclass(frozen=True, slots=True)
class Comparison:
    """A finished comparison: its verdict in words, and the report's file."""

    verdict: str
    report: Path


class Rig(Protocol):
    """A leader and its cameras, as the screen knows them; errors are SimulshotErrors."""

    def status(self) -> RigStatus:
        """Return the whole rig at this moment."""

    def on_news(self, tell: Callable[[str], None]) -> None:
        """Set who is told, in a line each, what happens."""

    async def burst(self, frames: int) -> BurstStatus:
        """Take a burst of that many instants and return when it is on disk."""

    async def add_simulated(self, cameras: int) -> None:
        """Start that many simulated cameras on this machine."""

    def compare(self, session: Path) -> AsyncIterator[ProgressStep | Comparison]:
        """Compare synchronized with offset frames; the last thing it yields is the Comparison."""
