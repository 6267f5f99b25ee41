"""People in 3D for a monitor's pages: when the process runs, what is sent, and what is said without them."""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.errors import NetworkError, NotAvailableError, SimulshotError
from capture_app.common.tasks import end
from capture_app.companions.monitor import people_feed as module
from capture_app.companions.monitor.people_feed import STARTING, PeopleFeed
from capture_app.protocol.status import RigStatus
from capture_app.rig.rig_link import RigLink
from capture_app.session.format.live_pictures import LivePerson, PeoplePreview
from tests.unit.companions.monitor.served import StandInMonitor, monitored
from tests.unit.tui.fake_rig import FakeRig
from tests.waiting import until

NOSE = (0.5, -1.25, 2.0, 0.0625)


def instant(number: int) -> PeoplePreview:
    """An instant at which person 2 shows her nose."""
    return PeoplePreview(
        number,
        "",
        late_ns=250_000_000,
        people=(LivePerson(2, {"nose": NOSE}),),
        joints=("nose", "left_hip"),
        bones=((0, 1),),
        path={"near": 0.25},
        unit="m",
        absent={"cam01": "syncing"},
    )


class StandInProcess:
    """What runs in place of the process: it yields what it is given, and raises errors among it."""

    def __init__(self) -> None:
        self.begun: list[tuple[str, ...]] = []
        """The cameras of the rig at each start."""
        self.running = self.most = 0
        self.given: asyncio.Queue[PeoplePreview | SimulshotError] = asyncio.Queue()

    async def __call__(
        self, link: RigLink, rig: RigStatus, choose: Callable[[], str]
    ) -> AsyncGenerator[PeoplePreview, None]:
        assert choose() == "", "no picture is drawn for the pages"
        self.begun.append(tuple(node.name for node in rig.cameras))
        self.running += 1
        self.most = max(self.most, self.running)
        try:
            while True:
                given = await self.given.get()
                if isinstance(given, SimulshotError):
                    raise given
                yield given
        finally:
            await asyncio.sleep(0.01)  # a process takes a while to end
            self.running -= 1


@pytest.fixture
def process(monkeypatch: pytest.MonkeyPatch) -> StandInProcess:
    process = StandInProcess()
    monkeypatch.setattr(module, "live_people", process)
    return process


class Sent:
    """The newest message to all pages."""

    def __init__(self) -> None:
        self.message: dict[str, Any] = {}

    def __call__(self, **fields: Any) -> None:
        self.message = fields


@pytest.fixture
def sent() -> Sent:
    return Sent()


@pytest.fixture
async def feed(process: StandInProcess, sent: Sent) -> AsyncIterator[PeopleFeed]:
    rig = FakeRig(2)
    feed = PeopleFeed(rig, sent)
    feed.follow(rig.status())
    running = asyncio.create_task(feed.run())
    yield feed
    await end(running)
    assert process.running == 0


async def test_one_process_runs_from_the_first_page_to_the_last(
    feed: PeopleFeed, process: StandInProcess
) -> None:
    await asyncio.sleep(0.02)
    assert process.begun == [], "nobody looks"
    feed.show_to("phone", is_shown=True)
    await until(lambda: process.running)
    feed.show_to("tablet", is_shown=True)
    feed.show_to("phone", is_shown=False)
    await asyncio.sleep(0.02)
    assert (len(process.begun), process.running) == (1, 1)
    feed.show_to("tablet", is_shown=False)
    await until(lambda: not process.running)
    feed.show_to("phone", is_shown=True)
    await until(lambda: process.running)
    # It is wanted again before it has ended.
    feed.show_to("phone", is_shown=False)
    await asyncio.sleep(0)
    feed.show_to("phone", is_shown=True)
    await until(lambda: len(process.begun) == 3)
    assert process.most == 1


async def test_pages_get_joints_with_errors_by_the_person_s_number(
    feed: PeopleFeed, process: StandInProcess, sent: Sent
) -> None:
    feed.show_to("phone", is_shown=True)
    process.given.put_nowait(instant(1))
    await until(lambda: "people" in sent.message)
    assert sent.message == {
        "words": "1 person; 1 joint, 95 % error 0.0625 m; without cam01: syncing",
        "people": {2: [NOSE, None]},
        "bones": ((0, 1),),
        "path": {"near": 0.25},
    }
    process.given.put_nowait(PeoplePreview(2, "", problem="the rig is not calibrated"))
    await until(lambda: sent.message["words"] == "the rig is not calibrated")
    assert sent.message["people"] == {}


async def test_a_process_that_ended_says_why_and_starts_when_a_page_asks(
    feed: PeopleFeed, process: StandInProcess, sent: Sent
) -> None:
    feed.show_to("phone", is_shown=True)
    feed.show_to("tablet", is_shown=True)
    process.given.put_nowait(NotAvailableError("BlazePose needs litert", hint="pip install it"))
    await until(lambda: sent.message == {"words": "BlazePose needs litert (pip install it)", "is_over": True})
    feed.show_to("phone", is_shown=False)
    await asyncio.sleep(0.02)
    assert len(process.begun) == 1, "a page that looks away is no wish for another try"
    feed.show_to("tablet", is_shown=True)
    await until(lambda: process.running)
    assert (len(process.begun), sent.message) == (2, {"words": STARTING})


async def test_other_cameras_and_a_leader_that_is_back_start_it_anew(
    feed: PeopleFeed, process: StandInProcess, sent: Sent
) -> None:
    feed.show_to("phone", is_shown=True)
    await until(lambda: process.running)
    feed.follow(FakeRig(2).status())
    await asyncio.sleep(0.02)
    assert len(process.begun) == 1, "the cameras are the same"
    feed.follow(FakeRig(3).status())
    await until(lambda: process.begun[1:] == [("cam00", "cam01", "cam02")])
    process.given.put_nowait(NetworkError("the leader does not answer"))
    await until(lambda: sent.message.get("is_over"))
    feed.follow(None)
    await until(lambda: sent.message == {"words": STARTING})
    assert process.running == 0
    feed.follow(FakeRig(3).status())
    await until(lambda: len(process.begun) == 3)


async def test_one_camera_is_too_few(feed: PeopleFeed, process: StandInProcess, sent: Sent) -> None:
    feed.follow(FakeRig(1).status())
    feed.show_to("phone", is_shown=True)
    await until(lambda: sent.message.get("is_over"))
    assert sent.message["words"] == "a joint in 3D needs two cameras, and the rig has 1 camera"
    assert process.begun == []
    feed.follow(FakeRig(2).status())
    await until(lambda: process.running)


async def test_only_pages_that_show_people_get_them_each_after_the_last(
    process: StandInProcess, tmp_path: Path
) -> None:
    async with (
        monitored(tmp_path, 2) as served,
        StandInMonitor(served.page) as page,
        StandInMonitor(served.page, "1" * 32) as other,
    ):
        await page.open()
        await other.open()
        while await page.hear() != "rig" or len(page.said["rig"]["cameras"]) < 2:
            pass
        await page.say(type="people", is_shown=True)
        while await page.hear() != "people":
            pass
        for number in range(3):
            process.given.put_nowait(instant(number))
        await until(process.given.empty)
        await page.say(type="seen", picture="live")
        while (heard := await page.hear()) != "live":
            assert heard != "people", "it has not drawn the last ones yet"
        await page.say(type="seen", picture="people")
        while await page.hear() != "people":
            pass
        assert page.said["people"]["people"] == {"2": [list(NOSE), None]}
        await page.session.close()
        await until(lambda: not process.running)
        for _ in range(5):
            await other.hear()
        assert "people" not in other.said
