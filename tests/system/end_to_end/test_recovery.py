"""Bursts whose leader or node is killed in the middle, finished afterwards."""

import json
from pathlib import Path

from capture_app.session.format.manifest import JOURNAL, MANIFEST
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.system.end_to_end.rig import burst, join, join_ready, lead, lines_of, output
from tests.waiting import until

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
