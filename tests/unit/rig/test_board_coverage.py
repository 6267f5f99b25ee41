"""The count of a board's views by a rig's previews."""

from collections.abc import AsyncGenerator
from typing import Any, cast

import cv2

from capture_app.board.boards import DEFAULT_BOARD
from capture_app.protocol.status import Preview
from capture_app.rig.board_coverage import watch_coverage
from capture_app.rig.rig_link import LinkLost, RigLink, Update
from tests.unit.tui.fake_rig import FakeRig


class LinkOf:
    """A link that yields these updates, and ends."""

    def __init__(self, *updates: Update) -> None:
        self._updates = updates

    async def want_previews(self, **_request: Any) -> None:
        """Take any request."""

    async def updates(self) -> AsyncGenerator[Update, None]:
        """Yield the updates."""
        for update in self._updates:
            yield update


async def test_a_lost_link_is_said_once_and_the_count_goes_on() -> None:
    rig = FakeRig(1).status()
    board = cv2.copyMakeBorder(DEFAULT_BOARD.picture(120), 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=255)
    height, width = board.shape
    jpeg = cv2.imencode(".jpg", board)[1].tobytes()
    seen = Preview(camera="cam00", leader_ns=0, width=width, height=height, jpeg=jpeg)
    link = cast("RigLink", LinkOf(rig, LinkLost("no answer"), rig, rig, seen))
    first, lost, back, counted = [found async for found in watch_coverage(link, rig)]
    assert not isinstance(first, str)
    assert first.cameras["cam00"].views == 0
    assert lost == "no answer; reconnecting, and the count so far is kept"
    assert back == "the rig is connected again: the count continues"
    assert not isinstance(counted, str)
    assert counted.cameras["cam00"].views == 1
