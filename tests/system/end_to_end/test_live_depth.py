"""Live depth of a rig of processes, with a burst in the middle, which loses nothing."""

import asyncio
from contextlib import aclosing
from pathlib import Path

from capture_app import AsyncRig
from capture_app.rig.live_pictures import live_depth
from capture_app.rig.rig_link import RigLink
from capture_app.session.format.live_pictures import DepthPreview
from tests.project import JUMPER
from tests.system.end_to_end.conftest import TIMEOUT_S, Start
from tests.system.end_to_end.rig import lead
from tests.waiting import SLOW_PATIENCE_S, time_limit, until

IMAGES = 40


async def test_a_burst_is_whole_while_depth_is_live(start: Start, tmp_path: Path) -> None:
    """Five VGA cameras give the jumper's pictures, as webcams do: as JPEGs."""
    leader, at = await lead(start, tmp_path / "sessions")
    names = [folder.name for folder in sorted((JUMPER / "images" / "rig1").iterdir())]
    for name in names:
        camera = f"replay:{JUMPER},camera={name}"
        await start("node", "--name", name, "--camera", camera, "--leader", at)
    found: list[DepthPreview] = []
    async with AsyncRig(at) as rig:
        status = await rig.wait_until_ready(len(names), SLOW_PATIENCE_S)
        await rig.burst(1)  # which has the recording's calibration

        async def follow() -> None:
            async with aclosing(live_depth(RigLink(rig.address), status, lambda: "cam04")) as depths:
                async for depth in depths:
                    found.append(depth)

        following = asyncio.create_task(follow())
        await until(lambda: len(found) >= 5 or following.done(), seconds=TIMEOUT_S)
        async with time_limit("the burst", TIMEOUT_S):
            burst = await rig.burst(IMAGES)
        assert len(burst.instants) == IMAGES
        assert not [frame for one in burst.instants for frame in one.frames.values() if frame.missing]
        before = len(found)
        await until(lambda: len(found) >= before + 5 or following.done(), seconds=TIMEOUT_S)
        assert not following.done()
        following.cancel()
        await asyncio.gather(following, return_exceptions=True)
    pictures = [depth for depth in found if depth.jpeg]
    assert len(pictures) > len(found) / 2
    assert all(depth.camera == "cam04" and depth.late_ns > 0 for depth in pictures)
    await leader.stop()
