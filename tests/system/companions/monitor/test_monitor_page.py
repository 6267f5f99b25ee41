"""The monitor's server without a browser: who is admitted, what is sent, and what orders do."""

import asyncio
import shutil
from pathlib import Path

from capture_app.common.tasks import end
from capture_app.companions.monitor.monitor_page import MonitorFeed
from tests.project import JUMPER
from tests.unit.companions.monitor.served import ServedMonitor, StandInMonitor
from tests.unit.companions.monitor.test_monitor_page import (
    JPEG_START,
    served,  # noqa: F401 - a fixture
)
from tests.unit.tui.fake_rig import FakeRig
from tests.waiting import SLOW_PATIENCE_S, time_limit, until


async def test_a_take_is_seen_by_all_monitors_and_its_pictures_come_on_request(
    served: ServedMonitor,
) -> None:
    async with StandInMonitor(served.page) as director, StandInMonitor(served.page, "1" * 32) as other:
        await director.open()
        await other.open()
        async with time_limit("a take", SLOW_PATIENCE_S):
            while director.said.get("rig", {}).get("cameras", []) == []:
                await director.hear()
            await director.say(type="take", plan={"frames": 2})
            while not other.said.get("take", {}).get("has_pictures"):
                await other.hear()
            name = other.said["take"]["name"]
            assert name == "burst-001"
            for kind, start in (("sheet", JPEG_START), ("wiggle", b"RIFF")):
                key = f"take/{name}/{kind}"
                await other.say(type="open", picture=key)
                while key not in other.pictures:
                    await other.hear()
                assert other.pictures[key][0].startswith(start)
            await other.say(type="open", picture=f"take/{name}/depth")
            while await other.hear() != "absent":
                pass
            assert "No depth" in other.said["absent"]["words"]
            assert other.said["absent"]["can_compute"]
            await other.say(type="depth")
            while other.said["absent"]["can_compute"] or "Computing" in other.said["absent"]["words"]:
                await other.hear()
            assert "no valid calibration" in other.said["absent"]["words"]
        assert not any(key.startswith("take/") for key in director.pictures)


async def test_depth_is_computed_when_a_monitor_asks(tmp_path: Path) -> None:
    shutil.copytree(JUMPER, tmp_path / "jumper")
    rig = FakeRig(1)
    rig.different = {"sessions": ("jumper",), "sessions_folder": str(tmp_path)}
    feed = MonitorFeed(rig, is_local=True)
    following = asyncio.create_task(feed.run())
    rig.tell()
    await until(lambda: "take" in feed.texts)
    feed.compute_depth()
    await until(lambda: "Computing" in feed.texts.get("absent", ""))
    await until(lambda: "take/jumper/depth" in feed.pictures, seconds=SLOW_PATIENCE_S)
    assert feed.pictures["take/jumper/depth"].startswith(b"\x89PNG")
    await end(following)
