"""The Lab Streaming Layer's stream of frame times: read back by pylsl, it has what the session has."""

import asyncio
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.clock import HostClock
from capture_app.common.host_clock import host_ns
from capture_app.companions.sensors.lsl_frames import CHANNELS, STREAM, LslFrames
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.rig.rig import AsyncRig
from tests.cheap_rig import cheap_cameras
from tests.waiting import until

pylsl = pytest.importorskip("pylsl", reason="pylsl is not installed")


def connected() -> Any:
    """An inlet of the stream of this machine."""
    found = pylsl.resolve_byprop("name", STREAM, timeout=30.0)
    assert found, "LSL finds no stream on this machine"
    inlet = pylsl.StreamInlet(found[0], processing_flags=pylsl.proc_none)
    inlet.open_stream(timeout=30.0)
    return inlet


@pytest.mark.parametrize("video", [False, True])
async def test_the_stream_has_the_times_of_the_saved_frames(tmp_path: Path, video: bool) -> None:
    options = LeaderOptions(sessions=tmp_path, host="127.0.0.1", port=0, followers=(LslFrames(),))
    async with await LeaderNode.start(options) as leader, cheap_cameras(2, leader.own_address):
        inlet = await asyncio.to_thread(connected)
        labels = []
        channel = inlet.info().desc().child("channels").child("channel")
        while not channel.empty():
            labels.append(channel.child_value("label"))
            channel = channel.next_sibling()
        assert tuple(labels) == CHANNELS
        async with AsyncRig(str(leader.own_address)) as rig:
            await rig.wait_until_ready(2)
            session = await (rig.record(1.0, name="run") if video else rig.burst(5, name="run"))
        got: dict[tuple[str, int], tuple[list[str], float]] = {}
        images = {(image.camera, image.instant): image for image in session.manifest.images}

        def pulled() -> bool:
            sample, at_s = inlet.pull_sample(timeout=0.0)
            while sample:
                got[sample[2], int(sample[1])] = sample, at_s
                sample, at_s = inlet.pull_sample(timeout=0.0)
            return len(got) >= len(images)

        await until(pulled)
    assert got.keys() == images.keys()
    lsl_less_host_s = pylsl.local_clock() - host_ns() / 1e9
    for key, (sample, at_s) in got.items():
        image = images[key]
        assert sample[0] == "run-001"
        assert round(float(sample[3]) * 1e9) == image.leader_ns
        assert round(float(sample[4]) * 1e9) == image.uncertainty_ns
        host_s = HostClock().true_from_local(image.leader_ns) / 1e9 + lsl_less_host_s
        assert abs(at_s - host_s) < 0.01
