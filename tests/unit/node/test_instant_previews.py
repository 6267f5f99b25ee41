"""Previews of one instant: chosen by the nodes, put together by the leader, received whole by operators."""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Sequence
from contextlib import AsyncExitStack, aclosing, asynccontextmanager
from itertools import pairwise
from pathlib import Path

import pytest
from msgspec.structs import replace

from capture_app import AsyncRig, Rig
from capture_app.common.address import Address
from capture_app.common.errors import IncompleteError, NetworkError
from capture_app.common.tasks import end
from capture_app.node.camera.viewfinder import MAX_PERIODS, periods_between
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.viewfinders import STORED, newest_instant
from capture_app.protocol.status import Preview, RigStatus
from capture_app.rig.instant_previews import InstantPreviews, LeaderMoments, collect, instant_previews
from capture_app.rig.rig_link import RigLink
from tests.cheap_rig import start_leader
from tests.unit.node.joining import joined
from tests.unit.node.test_viewfinder import Node
from tests.unit.tui.fake_rig import FakeRig
from tests.waiting import time_limit

pytestmark = [pytest.mark.usefixtures("open_rig"), pytest.mark.virtual]


def of(camera: str, *instants: int | None) -> list[Preview]:
    return [Preview(camera=camera, leader_ns=at, instant_ns=at, width=1, height=1) for at in instants]


def shown(*stored: Sequence[Preview]) -> list[tuple[str, int | None, bool]]:
    return [(one.camera, one.instant_ns, one.completes) for one in newest_instant(stored)]


def test_the_newest_instant_is_the_last_that_all_have() -> None:
    assert shown(of("a", 3, 6, 9), of("b", 3, 6)) == [("a", 6, False), ("b", 6, True)]
    assert shown(of("a", 3, 9), of("b", 3, 6)) == [("a", 3, False), ("b", 3, True)]
    assert shown(of("a", 3)) == [("a", 3, True)]
    assert shown() == []
    assert shown(of("a", 3), of("b", 6)) == [], "the others' are on their way"


def test_a_camera_without_instants_or_far_behind_does_not_hold_up_the_others() -> None:
    """A camera of an older version, one that is not synchronized, and one on a slow link."""
    fast = of("a", *range(10, 10 + STORED))
    assert shown(fast, of("b", None)) == [("b", None, False), ("a", 9 + STORED, True)]
    assert shown(fast, of("b", 9)) == [("b", 9, False), ("a", 9 + STORED, True)]
    assert shown(fast, of("b", 10)) == [("a", 10, False), ("b", 10, True)]
    even, odd = of("a", *range(0, 2 * STORED, 2)), of("b", *range(1, 2 * STORED, 2))
    assert shown(even, odd) == [("a", 2 * STORED - 2, False), ("b", 2 * STORED - 1, False)]


@pytest.mark.parametrize("period_ns", [8_333_333, 16_666_667, 33_333_333, 40_000_000, 66_666_667])
def test_slow_previews_show_instants_of_faster_ones(period_ns: int) -> None:
    periods = [periods_between(period_ns, fps) for fps in (30, 15, 10, 5, 2.5, 1.25, 0.1)]
    assert all(slower % faster == 0 for faster, slower in pairwise(periods))
    assert all(
        1e9 / (apart * period_ns) <= 1.06 * fps
        for apart, fps in zip(periods, (30, 15, 10, 5), strict=False)
        if apart > 1
    )
    assert periods_between(period_ns, 5e-324) == MAX_PERIODS


def test_a_set_is_of_the_instant_that_is_complete() -> None:
    newest: dict[str, Preview] = {}
    slow, first, second = *of("slow", 3), *of("a", 6), *of("b", 6)
    assert collect(newest, slow) is None
    assert collect(newest, first) is None
    last = Preview(camera="b", leader_ns=9, instant_ns=6, width=1, height=1, completes=True)
    found = collect(newest, last)
    assert found == InstantPreviews(6, {"a": first, "b": last})
    assert found.spread_ns == 3
    assert found.bgr() == {}, "they are no pictures"
    assert collect(newest, second) is None


@asynccontextmanager
async def rig_of(folder: Path, *names: str) -> AsyncIterator[tuple[LeaderNode, dict[str, Node]]]:
    async with AsyncExitStack() as stack:
        leader = await stack.enter_async_context(await start_leader(folder))
        await stack.enter_async_context(joined(leader.own_address, *((name, 5) for name in names)))
        nodes = {name: Node(name) for name in names}
        for node in nodes.values():
            node.viewfinder.set_leader(leader.own_address)
            stack.push_async_callback(end, asyncio.create_task(node.viewfinder.run()))
        yield leader, nodes


async def test_previews_are_of_one_instant(tmp_path: Path) -> None:
    """One camera is not synchronized, one gives every second frame only, and a slow reader skips instants."""
    async with rig_of(tmp_path, "a", "b", "new", "half") as (leader, nodes):
        nodes["new"].grid = None
        running = True

        async def expose() -> None:
            number = 0
            while running:
                number += 1
                for name, node in nodes.items():
                    if name != "half" or number % 2:
                        node.see(number, level=number % 250)
                await asyncio.sleep(0.01)

        exposing = asyncio.create_task(expose())
        async with time_limit("previews"), AsyncRig(str(leader.own_address)) as rig:
            found: list[InstantPreviews] = []
            async with aclosing(rig.previews(width=40, fps=30)) as previews:
                async for one in previews:
                    found.append(one)
                    await asyncio.sleep(0.05)
                    if len(found) == 8:
                        break
            cameras = [{*one.previews} for one in found]
            assert {"a", "b", "half"} in cameras
            # On a busy machine one may lag so far behind that the others do not wait for it.
            assert all(some <= {"a", "b", "half"} for some in cameras)
            for one in found:
                levels = {round(float(image.mean())) for image in one.bgr().values()}
                number = (one.instant_ns - 900_000_000) // 20_000_000
                assert max(abs(level - number % 250) for level in levels) <= 1, "all show that instant"
                assert number % 3 == 0, "at up to 30 a second, of 50"
                assert one.spread_ns == 0
                assert {*one.absent} == {*nodes} - {*one.previews}, "who is not in it is named"
            once = await rig.preview(width=40)
            assert once.instant_ns > found[-1].instant_ns
        running = False
        await exposing


class _Lagging(AsyncRig):
    """A rig of two ready cameras, of which `b` has a preview of every third instant only."""

    async def status(self) -> RigStatus:
        return FakeRig(2).status()

    async def previews(self, *_: object, **__: object) -> AsyncGenerator[InstantPreviews, None]:
        number = 0
        while True:
            number += 1
            names = ("cam00", "cam01")[: 1 + (number % 3 == 0)]
            images = {
                name: Preview(camera=name, leader_ns=number, instant_ns=number, width=4, height=3)
                for name in names
            }
            yield InstantPreviews(number, images)
            await asyncio.sleep(0.01)


async def test_one_preview_is_of_all_ready_cameras_or_of_most() -> None:
    rig = _Lagging("127.0.0.1:9")
    assert {*(await rig.preview()).previews} == {"cam00", "cam01"}
    assert {*(await rig.preview(wait_s=0.015)).previews} == {"cam00"}


def test_the_leaders_moments_are_those_of_its_quickest_status() -> None:
    moments = LeaderMoments()
    for leader_ns, here_ns in ((1000, 500), (2000, 1400), (3000, 2450)):
        moments.hear(leader_ns, here_ns)
    assert moments.here_ns(4000, 0) == 3400


def test_previews_and_rigs_are_told_in_a_line() -> None:
    one = InstantPreviews(6, {"a": replace(of("a", 6)[0], jpeg=b"pixels")}, absent={"b": "syncing"})
    assert repr(one) == "<InstantPreviews a 1x1, without b: syncing>"
    assert repr(AsyncRig("127.0.0.1:9")) == "<AsyncRig 127.0.0.1:9>"
    assert repr(Rig(simulated=2)) == "<Rig outside of its with block>"


async def test_a_rig_that_shows_no_instant_says_so(tmp_path: Path) -> None:
    async with rig_of(tmp_path, "a") as (leader, _), AsyncRig(str(leader.own_address)) as rig:
        with pytest.raises(IncompleteError, match=r"no synchronized camera gave a preview within 0\.2 s"):
            await rig.preview(wait_s=0.2)
    with pytest.raises(NetworkError):
        await anext(instant_previews(RigLink(Address("127.0.0.1", 9)), cameras=None, width=40, fps=30))
