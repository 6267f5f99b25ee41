"""Sound of a rig of processes: recorded with the images, and in step in the exported videos."""

import asyncio
import json
from pathlib import Path

import pytest

from capture_app.companions.exporting.export_session import export_session
from capture_app.plugins.cameras.sound.sound_ring import RATE_HZ
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.system.end_to_end.conftest import Command, Start
from tests.system.end_to_end.rig import lead, output
from tests.unit.plugins.programs.clicks import clicks_of
from tests.waiting import SLOW_PATIENCE_S, until

CAMERA = "sim:phone-a,drops=0,outliers=0,scale=0.1"


async def join(start: Start, address: str, name: str, sound: str) -> Command:
    at = ("--clock", "sim", "--leader", address)
    return await start("node", "--name", name, "--camera", f"{CAMERA}{sound}", *at)


def errors_ms(session: Session, out: Path) -> list[float]:
    """How late each click is that was at a whole second of the leader's clock, which is the host's."""
    burst = export_session(session, "mp4", out)
    at_s = [click_s + burst.origin_ns % 10**9 / 1e9 for click_s in clicks_of(out / "a.mp4")]
    return [1000 * (one_s - round(one_s)) for one_s in at_s]


@pytest.mark.parametrize("sound", ["sim", "sim:overrun"])
async def test_a_recordings_sound_is_in_step(start: Start, tmp_path: Path, sound: str) -> None:
    _, address = await lead(start, tmp_path / "sessions")
    nodes = await asyncio.gather(join(start, address, "a", f",sound={sound}"), join(start, address, "b", ""))
    await asyncio.gather(*(node.says("ready") for node in nodes))
    taken = await start("record", "--leader", address, "--seconds", "8", "--json")
    session = Session.open(Path(json.loads(await taken.finish())["session"]))
    assert verify(session) == []
    errors = errors_ms(session, tmp_path / "out")
    assert len(errors) >= 7
    assert max(map(abs, errors)) < 5.0
    with_sound, without = (video.bytes / video.frames for video in session.stored_manifest.videos)
    assert with_sound - without < 2 * 2 * RATE_HZ / 30


async def test_the_sound_of_a_node_that_was_killed_is_in_step(start: Start, tmp_path: Path) -> None:
    leader, address = await lead(start, tmp_path / "sessions")
    node, other = await join(start, address, "a", ",sound=sim"), await join(start, address, "b", "")
    await asyncio.gather(node.says("ready"), other.says("ready"))
    await output(await start("record", "--leader", address, "--detach", "--json"))
    lines = tmp_path / "sessions/recording-001/videos/rig1/a.frames.ndjson"
    await until(lambda: lines.is_file() and lines.read_bytes().count(b"\n") > 90, seconds=SLOW_PATIENCE_S)
    await node.kill()
    await (await join(start, address, "a", ",sound=sim")).says("ready")
    await output(await start("record", "--leader", address, "--stop"))
    await leader.says("saved as")
    session = Session.open(tmp_path / "sessions/recording-001")
    assert verify(session) == []
    errors = errors_ms(session, tmp_path / "out")
    assert len(errors) >= 2
    assert max(map(abs, errors)) < 5.0
