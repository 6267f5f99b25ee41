"""Images on their way to the disk: in batches, one after the other, and told while they wait."""

import asyncio
from collections.abc import Sequence
from pathlib import Path

import pytest

from capture_app.errors import DiskFullError, SimulshotError
from capture_app.node.burst.burst_session import waiting_text
from capture_app.node.burst.intake import ImageCommits
from capture_app.session.format.manifest import ImageRecord
from capture_app.session.writing.image_store import ReceivedImage
from tests.node.bursts import upload


class Disk:
    """Takes one batch at a time, each until it is let go on."""

    def __init__(self) -> None:
        self.batches: list[list[int]] = []
        self.turns: asyncio.Queue[None] = asyncio.Queue()

    async def save(self, images: Sequence[ReceivedImage]) -> list[SimulshotError | None]:
        self.batches.append([image.record.instant for image in images])
        await self.turns.get()
        return [DiskFullError("full") if image.record.instant == 3 else None for image in images]


def received(instant: int) -> ReceivedImage:
    return ReceivedImage(upload("a", instant).record, Path("file"))


async def test_images_that_come_during_a_sync_share_the_next() -> None:
    disk, saved = Disk(), list[ImageRecord]()
    commits = ImageCommits(disk.save, saved.append)
    futures = [commits.add(received(0))]
    await asyncio.sleep(0)
    futures += [commits.add(received(n)) for n in (1, 2, 3)]
    assert disk.batches == [[0]]
    disk.turns.put_nowait(None)
    await futures[0]
    disk.turns.put_nowait(None)
    await commits.wait_until_idle()
    assert disk.batches == [[0], [1, 2, 3]]
    assert [record.instant for record in saved] == [0, 1, 2]
    assert [future.exception() for future in futures[:3]] == [None] * 3
    with pytest.raises(DiskFullError):
        await futures[3]


async def test_a_long_wait_for_the_disk_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Disk()
    commits = ImageCommits(disk.save, lambda _: None)
    futures = [commits.add(received(n)) for n in range(2)]
    await asyncio.sleep(0)
    assert waiting_text(commits, []) == "", "it has only just begun"
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    monkeypatch.setattr(loop, "time", lambda: began_s + 8.0)
    assert waiting_text(commits, ["cam03"]) == "waiting for the disk: 2 images, 8 s"
    monkeypatch.undo()
    disk.turns.put_nowait(None)
    await asyncio.gather(*futures)
    assert waiting_text(commits, ["cam03"]) == "waiting to hear from cam03"
