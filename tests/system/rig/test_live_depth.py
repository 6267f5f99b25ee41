"""Live depth: from previews of one instant, by a process of its own, and what is said when there is none."""

import asyncio
import shutil
from contextlib import aclosing
from pathlib import Path

import pytest

from capture_app.common.errors import NetworkError
from capture_app.rig import live_pictures as module
from capture_app.rig.live_pictures import live_depth
from capture_app.session.reading.decoding import decode_preview
from tests.project import JUMPER
from tests.unit.rig.test_live_depth import (
    rig,  # noqa: F401 - a fixture
    show,
)
from tests.unit.tui.fake_rig import FakeRig
from tests.waiting import time_limit


async def test_depth_begins_once_the_rig_is_calibrated_and_follows_the_chosen_camera(
    rig: FakeRig, tmp_path: Path
) -> None:
    chosen = ["cam04"]
    async with time_limit("depth"), aclosing(live_depth(rig, rig.status(), lambda: chosen[0])) as found:
        show(rig, 0)
        first = await anext(found)
        assert first.problem.startswith("the rig is not calibrated (")
        shutil.copytree(JUMPER, tmp_path / "sessions" / "jumper")
        while first.problem.startswith("the rig"):
            show(rig, 0)
            first = await anext(found)
        assert (first.instant_ns, first.camera, first.problem) == (0, "cam04", "")
        assert decode_preview(first.jpeg).shape == (240, 320, 3)
        assert first.late_ns > 0
        chosen[0] = "door"
        coming = asyncio.ensure_future(anext(found))
        for _ in range(module.MAX_LACKING + 1):
            show(rig, 1)
            await asyncio.sleep(0.01)
        other = await coming
        assert other.jpeg == b""
        assert other.problem.startswith("door is not in the calibration")
        rig.lose_link("it is gone")
        with pytest.raises(NetworkError, match="it is gone"):
            await anext(found)
