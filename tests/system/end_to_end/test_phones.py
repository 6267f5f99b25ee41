"""A leader that lets phones be cameras: its server of phones is a process of its own, which ends with it."""

import json
from pathlib import Path

from capture_app.session.reading.reader import Session
from tests.unit.companions.phones.stand_in import JPEG, StandInPhone
from tests.waiting import until

from .conftest import Start


async def test_a_phone_joins_a_leader_by_the_page_that_it_shows(start: Start, tmp_path: Path) -> None:
    sessions = tmp_path / "sessions"
    where = ("--host", "127.0.0.1", "--port", "0", "--sessions", str(sessions))
    leader = await start("leader", *where, "--phones", "--json")
    address = (await leader.next_json())["leader"]
    told = await leader.next_json()
    assert told["event"] == "invitation"
    assert told["url"].startswith("https://127.0.0.1:")
    assert len(told["fingerprint"]) == 95

    phone = StandInPhone(told["url"])
    await phone.open()
    try:
        assert await phone.join() == "left"
        await phone.open_camera()
        await leader.says("left joined")
        asked = await start("burst", "--leader", address, "--wait-s", "200", "--frames", "2", "--json")
        done = json.loads(await asked.finish())
        session = Session.open(Path(done["session"]))
        assert [session.image_bytes(image) for image in session.manifest.images] == [JPEG, JPEG]
        assert (await leader.next_event("invitation"))["url"] != told["url"]

        await leader.stop()
        await until(lambda: phone.is_cut_off)
    finally:
        await phone.vanish()
