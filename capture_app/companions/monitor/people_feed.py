"""People in 3D for a monitor's pages: one process for all pages, which runs while any page shows them."""

import asyncio
from collections import deque
from collections.abc import Callable
from contextlib import aclosing

from capture_app.common import system
from capture_app.common.errors import IncompleteError, SimulshotError
from capture_app.common.tasks import first_of
from capture_app.common.text import UNREADABLE, count
from capture_app.protocol.status import RigStatus
from capture_app.rig.live_pictures import live_people
from capture_app.rig.rig_link import RigLink

STARTING = "Looking for people …"
RATED = 30
"""Number of latest instants by which the rate is stated."""


class PeopleFeed:
    """Joints of the people in front of a rig, for the pages that show them."""

    def __init__(self, link: RigLink, send: Callable[..., None]) -> None:
        """`send` sends all pages a message with the given fields."""
        self._link, self._send = link, send
        self._rig: RigStatus | None = None
        self._viewers = set[object]()
        self._is_running = False
        self._changed = asyncio.Event()

    def show_to(self, viewer: object, *, is_shown: bool) -> None:
        """Add or remove a page; the first one starts the process, also after it has failed."""
        (self._viewers.add if is_shown else self._viewers.discard)(viewer)
        if not self._viewers or (is_shown and not self._is_running):
            self._changed.set()

    def follow(self, rig: RigStatus | None) -> None:
        """Start again if the rig has other cameras now; None means that its leader is lost."""
        before, self._rig = self._rig, rig
        if rig is None or before is None or _cameras(before) != _cameras(rig):
            self._changed.set()

    async def run(self) -> None:
        """Run the process while any page shows people, until cancelled."""
        while True:
            self._changed.clear()
            await first_of(self._changed.wait(), self._locate())

    async def _locate(self) -> None:
        """Send the people of each instant, or the reason why there are none; then wait for a change."""
        self._send(words=STARTING)
        if self._viewers and self._rig is not None:
            self._is_running = True
            try:
                await self._send_people(self._rig)
            except (*UNREADABLE, SimulshotError, OSError) as error:
                self._send(words=str(error), is_over=True)
            finally:
                self._is_running = False
        await asyncio.Event().wait()

    async def _send_people(self, rig: RigStatus) -> None:
        if len(rig.cameras) < 2:
            raise IncompleteError(
                f"a joint in 3D needs two cameras, and the rig has {count(len(rig.cameras), 'camera')}"
            )
        times_s = deque[float](maxlen=RATED)
        async with aclosing(live_people(self._link.another(), rig, lambda: "")) as instants:
            async for instant in instants:
                times_s.append(system.monotonic_s())
                self._send(
                    words=instant.described(times_s, rig.titles),
                    people={
                        person.number: [person.joints.get(joint) for joint in instant.joints]
                        for person in instant.people
                    },
                    bones=instant.bones,
                    path=instant.path,
                )


def _cameras(rig: RigStatus) -> dict[str, object]:
    return {node.name: node.camera for node in rig.cameras}
