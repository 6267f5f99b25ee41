"""Camera nodes on the leader's machine that end by themselves, with processes that are only drawn."""

import asyncio
import contextlib
from contextlib import aclosing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from capture_app.common.address import Address
from capture_app.common.errors import BadInputError, CameraError
from capture_app.node.leader.local_nodes import LocalNodes
from capture_app.protocol.log import Log
from capture_app.trust.trust import Trust

pytestmark = pytest.mark.virtual
STOPS_S = {"slow": 20.0, "stuck": 50.0}
"""Time in which nodes of these names end, in seconds."""


@pytest.fixture
def started_s(monkeypatch: pytest.MonkeyPatch, lives_s: list[float]) -> list[float]:
    """Times at which a node's process was started; each lives as long as given, and further ones for ever."""
    times, left_s = list[float](), iter(lives_s)

    async def start(name: str, *_: Any, **__: Any) -> Any:
        now_s = asyncio.get_running_loop().time
        times.append(now_s())
        ends_s, spoken = now_s() + next(left_s, 1e9), asyncio.Event()
        spoken.set()

        async def wait() -> None:
            await asyncio.sleep(ends_s - now_s())

        async def failure() -> CameraError:
            return CameraError(f"{name} ended")

        async def stop(timeout_s: float) -> bool:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(timeout_s):
                    await asyncio.sleep(STOPS_S.get(name, 0.0))
                    return True
            return False

        process = SimpleNamespace(wait=wait, returncode=None)
        return SimpleNamespace(process=process, spoken=spoken, failure=failure, stop=stop)

    monkeypatch.setattr("capture_app.node.leader.local_nodes.Child", SimpleNamespace(start=start))
    return times


@pytest.mark.parametrize("lives_s", [[]])
async def test_a_node_that_is_stopped_has_time_to_save_its_frames(
    started_s: list[float], tmp_path: Path
) -> None:
    """It was killed after 2 s, and what a slow camera had taken was lost."""
    log = Log()
    nodes = LocalNodes(Address("127.0.0.1", 1), tmp_path, log, trust=Trust.open())
    for name in ("quick", "slow", "stuck"):
        await nodes.add_camera("v4l2:/dev/" + name, name)
    begun_s = asyncio.get_running_loop().time()
    await nodes.aclose()
    assert asyncio.get_running_loop().time() - begun_s == pytest.approx(30.0, abs=0.1)
    assert [line.text for line in log.after(0)] == [
        "slow is still ending: it saves its frames first; stop again to drop them",
        "stuck is still ending: it saves its frames first; stop again to drop them",
        "stuck had not saved all its frames in 30 s, and was ended",
    ]


@pytest.mark.parametrize(
    ("lives_s", "delays_s", "is_here"),
    [
        ([2.0, 2.0, 2.0, 2.0], [1, 10, 60], False),
        ([2.0, 2.0, 301.0, 2.0], [1, 10, 1, 10], True),
    ],
    ids=["given up", "sound for a while"],
)
async def test_a_node_that_ends_is_started_again_ever_later(
    lives_s: list[float], delays_s: list[float], is_here: bool, started_s: list[float], tmp_path: Path
) -> None:
    log = Log()
    nodes = LocalNodes(Address("127.0.0.1", 1), tmp_path, log, trust=Trust.open())
    async with aclosing(nodes):
        await nodes.add_camera("replay:clip.mp4", "cam0")
        await asyncio.sleep(1000)
        ended_s = [begun_s + lasts_s for begun_s, lasts_s in zip(started_s, lives_s, strict=False)]
        waited_s = [after - before for before, after in zip(ended_s, started_s[1:], strict=False)]
        assert waited_s == pytest.approx(delays_s, abs=0.1)
        assert [*nodes.specs] == ["cam0"] * is_here
        times = len(started_s)
        assert await nodes.add_camera("replay:clip.mp4", "cam0") == "cam0"
        assert len(started_s) == times + (not is_here), "a camera that was given up can be started by hand"
    assert [line.text for line in log.after(0)].count("cam0 ended; it is started again in 1 s") == 1 + is_here


@pytest.mark.parametrize("lives_s", [[]])
async def test_a_camera_is_started_once_and_only_so_many(
    started_s: list[float], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("capture_app.node.leader.local_nodes.MAX_NODES", 1)
    async with aclosing(LocalNodes(Address("127.0.0.1", 1), tmp_path, Log(), trust=Trust.open())) as nodes:
        name = await nodes.add_camera("replay:clip.mp4")
        assert (
            await nodes.add_camera("replay:clip.mp4")
            == await nodes.add_camera("replay:clip.mp4", name)
            == name
        )
        assert len(started_s) == 1
        with pytest.raises(BadInputError, match=f"a node named {name} already exists"):
            await nodes.add_camera("replay:other.mp4", name)
        with pytest.raises(BadInputError, match="1 nodes already run on this machine"):
            await nodes.add_camera("replay:other.mp4")
