"""A rig of IP cameras and a simulated one, in real processes: times by truth, and what is never told."""

import asyncio
import json
from contextlib import AsyncExitStack
from pathlib import Path

from capture_app.cameras.frames import JpegPicture
from capture_app.common.host_clock import host_from_monotonic
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.system.end_to_end.rig import burst, join_ready, lead, output
from tests.unit.plugins.cameras.rtsp.ip_camera import IpCamera, number_shown

from .conftest import Start

SECRET = "s3cret"
WIDE_MS = 250


def files_with(folder: Path, text: bytes) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file() and text in path.read_bytes()]


async def test_ip_cameras_with_wrong_clocks_take_bursts_and_recordings_beside_a_simulated_one(
    start: Start, tmp_path: Path
) -> None:
    login = ("admin", SECRET)
    sources = {
        "early": IpCamera(fps=30, wall_error_s=3.0, rate_ppm=40.0, login=login),
        "late": IpCamera(fps=30, wall_error_s=-3600.0, rate_ppm=-40.0, login=login),
        "mute": IpCamera(fps=30, report_every_s=None, login=login),
    }
    async with AsyncExitStack() as stack:
        for source in sources.values():
            await stack.enter_async_context(source.running())
        _, address = await lead(start, tmp_path / "sessions")
        nodes = {
            name: await start(
                *("node", "--name", name, "--leader", address),
                *("--camera", source.url(f"admin:{SECRET}")),
            )
            for name, source in sources.items()
        }
        await asyncio.gather(
            *(node.says("ready") for node in nodes.values()), join_ready(start, address, "simulated")
        )
        session = Session.open(Path((await burst(start, address, "--frames", "3"))["session"]))
        assert verify(session) == []
        assert {image.camera for image in session.manifest.images} == {*sources, "simulated"}
        for image in session.manifest.images:
            if image.camera not in sources:
                continue
            shown = number_shown(JpegPicture(session.image_bytes(image)))
            # The leader's clock is this machine's, and a camera's truth is in CLOCK_MONOTONIC.
            error_ns = min(
                (
                    image.leader_ns - host_from_monotonic(true_ns)
                    for true_ns in sources[image.camera].true_ns[shown]
                ),
                key=abs,
            )
            assert abs(error_ns) <= image.uncertainty_ns, (image.camera, error_ns)
            assert (image.uncertainty_ns > WIDE_MS * 1_000_000) == (image.camera == "mute")
        sources["early"].hang_up()
        heard = len(nodes["early"].said)
        await nodes["early"].says("camera failed", after=heard)
        await nodes["early"].says("camera is back", after=heard)
        await burst(start, address, "--frames", "2")
        took = ("record", "--leader", address, "--seconds", "2", "--wait-s", "60", "--json")
        recording = Session.open(Path(json.loads(await output(await start(*took)))["session"]))
        assert {video.camera for video in recording.manifest.videos} == {*sources, "simulated"}
        assert min(video.frames for video in recording.manifest.videos) >= 55
        assert SECRET not in "".join(line for node in nodes.values() for line in node.said)
    assert not files_with(tmp_path, SECRET.encode())
