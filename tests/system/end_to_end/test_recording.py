"""Long bursts and recordings by a rig of processes: every frame is there, however they end."""

import asyncio
import json
import signal
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.errors import ExitCode
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.system.end_to_end.rig import lead, output
from tests.unit.node.test_disks import fill, mounted
from tests.waiting import SLOW_PATIENCE_S, until

from .conftest import TIMEOUT_S, Command, Start


async def rig_of_two(start: Start, folder: Path) -> tuple[Command, str]:
    """Two simulated cameras that drop nothing, of cheap pictures, ready below a leader."""
    leader, address = await lead(start, folder / "sessions")
    camera = "sim:phone-a,drops=0,outliers=0,scale=0.1"
    nodes = [
        await start("node", "--name", name, "--camera", camera, "--clock", "sim", "--leader", address)
        for name in ("a", "b")
    ]
    await asyncio.gather(*(node.says("ready") for node in nodes))
    return leader, address


async def take(start: Start, *command: str) -> Session:
    """Take something whole: a starved machine's simulated drivers drop what nobody fetches in time."""
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            running = await start(*command, "--wait-s", str(TIMEOUT_S), "--min-nodes", "2", "--json")
            printed = await running.finish()
            assert running.process.returncode in (ExitCode.OK, ExitCode.INCOMPLETE), running.said
            done: dict[str, Any] = json.loads(printed)
            session = Session.open(Path(done["session"]))
            assert verify(session) == []
            assert len(session.manifest.images) == done["received"]
            if running.process.returncode == ExitCode.OK:
                return session


async def test_frames_of_long_bursts_and_recordings_are_all_there(start: Start, tmp_path: Path) -> None:
    _, address = await rig_of_two(start, tmp_path)

    burst = await take(start, "burst", "--leader", address, "--frames", "100")
    assert len(burst.manifest.images) == 200
    assert burst.manifest.burst.skipped == ()

    recording = await take(start, "record", "--leader", address, "--seconds", "3")
    assert [(v.camera, v.frames) for v in recording.manifest.videos] == [("a", 90), ("b", 90)]
    assert recording.folder.name.startswith("recording-")

    halved = await take(start, "record", "--leader", address, "--seconds", "1", "--fps", "15")
    assert len(halved.manifest.burst.instants_ns) == 15
    odd = await start("record", "--leader", address, "--fps", "20")
    await odd.finish()
    assert odd.process.returncode == ExitCode.BAD_INPUT
    assert "30, 15, 10" in " ".join(odd.said)


async def test_a_recording_without_an_end_is_ended_by_a_command_or_ctrl_c(
    start: Start, tmp_path: Path
) -> None:
    leader, address = await rig_of_two(start, tmp_path)
    began = json.loads(await output(await start("record", "--leader", address, "--detach", "--json")))
    assert began["recording"]
    await asyncio.sleep(1.0)
    await output(await start("record", "--leader", address, "--stop"))
    await leader.says("saved as")
    first = Session.open(tmp_path / "sessions/recording-001")
    assert verify(first) == []
    assert len(first.manifest.burst.instants_ns) > 20

    running = await start("record", "--leader", address, "--json")
    await running.says("images")
    running.process.send_signal(signal.SIGINT)
    done = json.loads(await running.finish())
    assert done["done"]
    assert verify(Session.open(Path(done["session"]))) == []


@pytest.mark.timeout(600)
async def test_300_frames_and_20_seconds_lose_nothing(start: Start, tmp_path: Path) -> None:
    _, address = await rig_of_two(start, tmp_path)
    burst = await take(start, "burst", "--leader", address, "--frames", "300")
    assert len(burst.manifest.images) == 600
    recording = await take(start, "record", "--leader", address, "--seconds", "20")
    assert [(v.camera, v.frames) for v in recording.manifest.videos] == [("a", 600), ("b", 600)]


async def test_a_recording_outlives_its_leader(start: Start, tmp_path: Path) -> None:
    leader, address = await rig_of_two(start, tmp_path)
    await output(await start("record", "--leader", address, "--detach", "--json"))
    lines = [tmp_path / f"sessions/recording-001/videos/rig1/{name}.frames.ndjson" for name in ("a", "b")]
    await until(
        lambda: all(file.is_file() and file.stat().st_size > 5_000 for file in lines), seconds=SLOW_PATIENCE_S
    )
    await leader.kill()
    safe = [file.read_bytes().splitlines(keepends=True) for file in lines]

    await lead(start, tmp_path / "sessions", at=address)
    await until((tmp_path / "sessions/recording-001/session.json").exists)
    session = Session.open(tmp_path / "sessions/recording-001")
    assert verify(session) == []
    for file, before in zip(lines, safe, strict=True):
        whole = [line for line in before if line.endswith(b"\n")]
        assert file.read_bytes().splitlines(keepends=True)[: len(whole)] == whole
    # Nodes record on until they join the leader's successor, and bring that too.
    assert len(session.manifest.images) > sum(map(len, safe))


async def test_a_recording_that_a_full_disk_ended_is_whole_at_the_leaders_next_start(
    start: Start, tmp_path: Path
) -> None:
    with mounted(tmp_path / "sessions", "-o", "size=64m") as disk:
        leader, address = await rig_of_two(start, tmp_path)
        running = await start("record", "--leader", address, "--seconds", "10", "--json")
        await running.says("images")
        lines = disk / "recording-001/videos/rig1/b.frames.ndjson"
        await until(lambda: lines.is_file() and lines.stat().st_size > 5_000, seconds=SLOW_PATIENCE_S)
        filling = await asyncio.to_thread(fill, disk)
        ended = json.loads(await running.finish())
        assert "the leader's disk is full" in ended["message"]
        assert ended["received"] < ended["expected"]
        await leader.kill()
        filling.unlink()

        await lead(start, disk, at=address)
        spools = tmp_path / "state/simulshot/spool"
        await until(lambda: not [*spools.glob("*/*/*.film")], seconds=SLOW_PATIENCE_S)
        # On a busy machine a simulated camera drops frames, as any does.
        await until(lambda: all(gap.dropped for gap in Session.open(disk / "recording-001").manifest.missing))
        session = Session.open(disk / "recording-001")
        assert verify(session) == []
        assert len(session.manifest.images) + len(session.manifest.missing) == ended["expected"]
