"""Bursts whose leader or node is killed in the middle, finished afterwards."""

import json
import os
import signal
from pathlib import Path

from capture_app.session.format.manifest import JOURNAL, MANIFEST
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.system.end_to_end.processes import children_of, is_running
from tests.system.end_to_end.rig import burst, join, join_ready, lead, lines_of, output
from tests.waiting import SLOW_PATIENCE_S, until

from .conftest import TIMEOUT_S, Start


async def test_a_leader_killed_in_a_burst_finishes_it_at_the_next_start(start: Start, tmp_path: Path) -> None:
    leader, address = await lead(start, tmp_path / "sessions")
    await join_ready(start, address, "a", "b")
    asking = await start("burst", "--leader", address, "--wait-s", str(TIMEOUT_S), "--frames", "12")
    session = tmp_path / "sessions" / "burst-001"
    await lines_of(session / JOURNAL, 2)
    await leader.kill()
    assert not (session / MANIFEST).exists()
    safe = {path: path.read_bytes() for path in session.glob("images/rig1/*/*.jpg")}

    leader, _ = await lead(start, tmp_path / "sessions", address)
    await leader.says("burst-001 of an earlier run: 24 of 24 images")
    await until((session / MANIFEST).exists)
    # The command followed the burst through the restart.
    await asking.finish()
    opened = Session.open(session)
    assert verify(opened) == []
    assert (len(opened.manifest.images), opened.manifest.missing) == (24, ())
    assert opened.manifest.origin == "simulated"
    assert {path: path.read_bytes() for path in safe} == safe
    # The rig goes on as if nothing had happened.
    assert (await burst(start, address, "--frames", "1", "--min-nodes", "2"))["received"] == 2


async def test_what_a_killed_node_had_spooled_is_fetched_when_it_is_started_again(
    start: Start, tmp_path: Path
) -> None:
    leader, address = await lead(start, tmp_path / "sessions")
    (node,) = await join_ready(start, address, "a")
    asking = await start("burst", "--leader", address, "--wait-s", str(TIMEOUT_S), "--frames", "20")
    session = tmp_path / "sessions" / "burst-001"
    await lines_of(session / JOURNAL, 1)
    await leader.kill()
    await asking.kill()
    # The node goes on into its spool without a leader, until its plug is pulled too.
    (spooled,) = (tmp_path / "state/simulshot/spool/a").iterdir()
    await until(lambda: sum(file.read_bytes().count(b"\n") for file in spooled.glob("*.ndjson")) == 20)
    await node.kill()

    options = ("--wait-s", str(TIMEOUT_S), "--listen", address, "--json")
    command = await start("sessions", "repair", str(session), *options)
    await join(start, "a", address)
    repaired = json.loads(await output(command))["sessions"]
    assert (repaired[0]["ok"], repaired[0]["missing"]) == (True, 0), repaired
    opened = Session.open(session)
    assert verify(opened) == []
    assert len(opened.manifest.images) == 20
    await until(lambda: not spooled.exists())


async def test_a_leaders_own_camera_brings_what_its_last_run_was_still_writing(
    start: Start, tmp_path: Path
) -> None:
    """The next leader's camera has its name, and another spool: what was in the first one stayed there."""
    camera = ("--camera", "sim:phone-a,drops=0,outliers=0")
    leader, address = await lead(start, tmp_path / "sessions", options=camera)
    await leader.says("joined")
    asking = await start("burst", "--leader", address, "--wait-s", str(TIMEOUT_S), "--frames", "20")
    session, spool = tmp_path / "sessions" / "burst-001", tmp_path / "state/simulshot/spool"
    await lines_of(session / JOURNAL, 1)
    (node,) = children_of(leader.process.pid)
    leader.process.send_signal(signal.SIGSTOP)
    await asking.kill()
    await until(lambda: sum(file.read_bytes().count(b"\n") for file in spool.glob("*/*/*.ndjson")) >= 15)
    os.kill(node, signal.SIGSTOP)
    try:
        await leader.kill()
        leader, _ = await lead(start, tmp_path / "sessions", address, options=camera)
        await leader.says("joined")
        assert len([*spool.glob(".2/*")]) == 1
    finally:
        os.kill(node, signal.SIGCONT)
    await until((session / MANIFEST).exists, seconds=SLOW_PATIENCE_S)
    await until(lambda: not Session.open(session).manifest.missing, seconds=SLOW_PATIENCE_S)
    opened = Session.open(session)
    assert (verify(opened), len(opened.manifest.images)) == ([], 20)
    await until(lambda: not [*spool.glob("**/*.film")])
    assert not is_running(node)
