"""The monitor's server without a browser: who is admitted, what is sent, and what orders do."""

import asyncio
import json
from collections.abc import AsyncIterator
from functools import partial
from pathlib import Path

import aiohttp
import pytest
from msgspec.structs import replace

from capture_app.common.tasks import end
from capture_app.companions.monitor.monitor_page import MonitorFeed
from capture_app.protocol.orders import EndBurst
from capture_app.protocol.status import BurstStatus
from capture_app.rig.instant_previews import APART_S, OLD_S
from capture_app.web.paired_page import MAX_LINKS_PER_DEVICE
from tests.unit.companions.monitor.served import ServedMonitor, StandInMonitor, monitored
from tests.unit.tui.fake_rig import FakeRig
from tests.waiting import time_limit, until

JPEG_START = b"\xff\xd8"


@pytest.fixture
async def served(tmp_path: Path) -> AsyncIterator[ServedMonitor]:
    async with monitored(tmp_path, 2) as served:
        yield served


async def test_a_stranger_without_the_code_is_refused(served: ServedMonitor) -> None:
    async with StandInMonitor(served.page) as stranger:
        status, body = await stranger.join(secret="")
        assert status == 403
        assert body["words"] == "This monitor is not known here yet: scan the code that the leader shows."
        status, _ = await stranger.join(secret="guessed")
        assert status == 403
        with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
            await stranger.session.ws_connect(f"{served.base}link/guessed")


async def test_a_foreign_origin_or_host_is_refused(served: ServedMonitor) -> None:
    async with StandInMonitor(served.page) as monitor:
        status, _ = await monitor.join(Origin="https://evil.example")
        assert status == 403
        status, _ = await monitor.join(Host="rebound.example")
        assert status == 403
        status, _ = await monitor.join(Origin=served.base.rstrip("/"))
        assert status == 200


async def test_pictures_of_an_instant_come_together_once_the_last_were_drawn(served: ServedMonitor) -> None:
    async with StandInMonitor(served.page) as slow, StandInMonitor(served.page, "1" * 32) as quick:
        await slow.open()
        await quick.open()
        while await slow.hear() != "live":
            pass
        heard = 0
        while heard < 8:
            before = {key: len(pictures) for key, pictures in quick.pictures.items()}
            while await quick.hear() != "live":
                pass
            new = {key for key, pictures in quick.pictures.items() if len(pictures) > before.get(key, 0)}
            assert new == {f"live/{name}" for name in quick.said["live"]["ages_s"]}
            assert all(0 <= age_s < 10 for age_s in quick.said["live"]["ages_s"].values())
            heard += len(new) == 2
            assert quick.said["rig"]["apart_s"] == APART_S
            assert quick.said["rig"]["old_s"] == OLD_S
            await quick.say(type="seen", picture="live")
        assert all(len(pictures) == 1 for pictures in slow.pictures.values()), "it has drawn none yet"
        await slow.say(type="seen", picture="live")
        while await slow.hear() != "live":
            pass
        assert all(each.startswith(JPEG_START) for pictures in slow.pictures.values() for each in pictures)


async def test_an_order_that_cannot_be_is_answered_and_nonsense_ends_the_link(served: ServedMonitor) -> None:
    async with StandInMonitor(served.page) as monitor:
        await monitor.open()
        await monitor.say(type="take", plan={"frames": 0})
        while await monitor.hear() != "refused":
            pass
        assert "frames of a take is 0" in monitor.said["refused"]["words"]
        await monitor.say(type="take", plan={"frames": 1, "countdown_s": 60})
        while monitor.said.get("course", {}).get("state") != "countdown":
            await monitor.hear()
        await monitor.say(type="stop")
        while monitor.said["course"]["state"] != "idle":
            await monitor.hear()
        await monitor.say(type="dance")
        async with time_limit("the end of the link"):
            while (await monitor.link.receive()).type is not aiohttp.WSMsgType.CLOSE:
                pass
        assert monitor.link.close_code == 1003


async def test_a_device_has_few_links_however_many_it_opens(served: ServedMonitor) -> None:
    """One admitted monitor opened as many as it liked, each of which follows the rig."""
    async with StandInMonitor(served.page) as monitor, StandInMonitor(served.page, "1" * 32) as other:
        await other.open()
        links = []
        for _ in range(MAX_LINKS_PER_DEVICE + 2):
            await monitor.open()
            links.append(monitor.link)
        for link in links[:2]:
            async with time_limit("the end of the oldest links"):
                while (closed := await link.receive()).type is not aiohttp.WSMsgType.CLOSE:
                    pass
            assert (closed.data, closed.extra) == (
                1003,
                "Too many pages of this device are open: close some.",
            )
        for link in (*links[2:], other.link):
            monitor.link = link
            await monitor.hear()


async def test_a_recording_that_was_stopped_is_being_saved(tmp_path: Path) -> None:
    rig = FakeRig(1)
    rig.burst_status = BurstStatus(
        burst=1, name="recording-001", cameras=1, instants=30, received=2, expected=30, recording=True
    )
    feed = MonitorFeed(rig, is_local=True)
    following = asyncio.create_task(feed.run())
    rig.tell()
    await until(lambda: '"is_recording":true' in feed.texts.get("burst", ""))
    await feed.stop()
    rig.tell()
    await until(lambda: '"is_recording":false' in feed.texts["burst"])
    await feed.stop()
    assert [asked for asked in rig.asked if asked[0] == "order"] == [("order", EndBurst(burst=1))]
    await end(following)


def contains(feed: MonitorFeed, text: str) -> bool:
    return text in feed.texts.get("burst", "")


async def test_a_recording_that_ended_by_itself_is_not_stopped() -> None:
    rig = FakeRig(1)
    recording = BurstStatus(
        burst=1, name="recording-001", cameras=1, instants=30, received=2, expected=30, recording=True
    )
    feed = MonitorFeed(rig, is_local=True)
    following = asyncio.create_task(feed.run())
    for ended, shown in ((False, '"is_recording":true'), (True, '"is_recording":false')):
        rig.burst_status = replace(recording, ended=ended)
        rig.tell()
        await until(partial(contains, feed, shown))
    await feed.stop()
    assert not [asked for asked in rig.asked if asked[0] == "order"]
    await end(following)


async def test_a_program_marks_by_http_and_a_stranger_does_not(served: ServedMonitor) -> None:
    async with StandInMonitor(served.page) as program:

        async def post(**asked: str) -> tuple[int, dict[str, object]]:
            async with program.session.post(f"{served.base}mark", json=asked) as answer:
                return answer.status, await answer.json()

        key = "a" * 32
        for stranger in ({"key": key}, {"key": key, "secret": "guessed"}, {"key": "x"}):
            assert (await post(text="theirs", **stranger))[0] == 403
        for nonsense in ({}, {"text": "only"}):
            assert (await post(**nonsense))[0] == 400
        status, body = await post(text="one", key=key, secret=served.page.admission.secret)
        assert (status, body["sessions"]) == (200, [])
        # It is admitted from then on, and another is not by the same secret.
        assert (await post(text="two", key=key))[0] == 200
        assert (await post(text="", key=key))[0] == 400
        async with program.session.post(
            f"{served.base}mark", json={"text": "x", "key": key}, headers={"Origin": "https://evil.example"}
        ) as answer:
            assert answer.status == 403
    kept = await asyncio.to_thread(Path(str(body["file"])).read_text)
    assert [json.loads(line)["text"] for line in kept.splitlines()] == ["one", "two"]
