"""Takes that are not saved yet, as a rig's status lists them: nothing of them is to be cut off."""

from pathlib import Path

import pytest

from capture_app.rig.rig_link import ask_status
from capture_app.sync.rig.burst_orders import BurstOrder
from tests.cheap_rig import start_leader
from tests.unit.node.joining import joined

pytestmark = [pytest.mark.usefixtures("open_rig"), pytest.mark.virtual]


async def test_a_status_has_earlier_takes_until_they_are_saved(tmp_path: Path) -> None:
    async with await start_leader(tmp_path) as node, joined(node.own_address, ("cam0", 1234567)):
        recording = await node.bursts.order(BurstOrder(frames=10_000, streamed=True, video=True))
        newest = await node.bursts.order(BurstOrder(frames=1))
        status = await ask_status(node.own_address)
        assert status.burst is not None
        assert status.burst.burst == newest.burst.number
        (earlier,) = status.unsaved
        assert (earlier.name, earlier.recording, earlier.done) == (recording.status.name, True, False)
        assert (earlier.transfer, earlier.message) == ((), "")
        await node.bursts.cancel(recording.burst.number)
        assert not (await ask_status(node.own_address)).unsaved
