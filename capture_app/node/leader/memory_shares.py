"""Memory for images that are not on the disk yet: the same share for each machine, whatever names it uses."""

import asyncio
from collections import Counter


class MemoryShares:
    """Reservations of memory by machine; beyond a machine's share they wait for earlier images."""

    def __init__(self, share_bytes: int) -> None:
        self._share_bytes, self._given_back = share_bytes, asyncio.Event()
        self._taken: Counter[str] = Counter()

    async def take(self, machine: str, size: int) -> None:
        """Reserve `size` bytes for a machine, as soon as its share has them; all of it for a larger image."""
        while self._taken[machine] and self._taken[machine] + size > self._share_bytes:
            self._given_back.clear()
            await self._given_back.wait()
        self._taken[machine] += size

    def give_back(self, machine: str, size: int) -> None:
        """Free a reservation."""
        self._taken[machine] -= size
        self._given_back.set()
