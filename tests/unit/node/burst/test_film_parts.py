"""Parts of a recording at the leader: acknowledged when they are on disk, refused frame by frame."""

import asyncio
import os
from hashlib import sha256
from pathlib import Path

import pytest
from msgspec.structs import replace

from capture_app.common.address import Address
from capture_app.common.errors import BadInputError, DamagedImageError, DiskError, TryAgainError
from capture_app.machine.repair import repair
from capture_app.node.burst.burst_session import BurstSession
from capture_app.protocol.log import Log
from capture_app.protocol.messages import ImageBatch, Refusal
from capture_app.session.format.burst_plan import MissingRun
from capture_app.session.format.journal import frame_line
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from capture_app.session.writing.image_store import StoredImage
from tests.images import small_jpeg
from tests.unit.node.burst.test_broken_off_recordings import begin, recording_of, whole
from tests.unit.node.bursts import IMAGE, LEADER, pieces, report, upload

OTHER = small_jpeg(b"another picture")
TORN = IMAGE[: len(IMAGE) // 2]


def part(*instants: int, data: bytes = IMAGE) -> ImageBatch:
    frames = [upload("a", instant) for instant in instants]
    told = {"bytes": len(data), "sha256": sha256(data).hexdigest()}
    return ImageBatch(images=tuple(replace(of, record=replace(of.record, **told)) for of in frames))


async def bring(session: BurstSession, sent: ImageBatch, data: bytes) -> str:
    return await (await session.take(sent, pieces(data), 0))


async def test_frames_of_a_part_follow_each_other_in_the_film(tmp_path: Path) -> None:
    session = recording_of(tmp_path, "a", frames=4)
    await begin(session, "a")
    sent = ImageBatch(images=(*part(0, 1).images, *part(2, data=OTHER).images))
    assert await bring(session, sent, IMAGE + IMAGE + OTHER) == sha256(OTHER).hexdigest()
    # After a broken stream some come again.
    await bring(session, part(1, 3), IMAGE + IMAGE)
    await session.accept_report(report("a").with_plan(picked=4), 0)
    saved = whole(session.folder)
    images = [saved.image_bytes(image) for image in saved.manifest.images]
    assert images == [IMAGE, IMAGE, OTHER, IMAGE]


async def test_a_damaged_frame_costs_no_other_one(tmp_path: Path) -> None:
    session = recording_of(tmp_path, "a", frames=4)
    await begin(session, "a")
    sent = ImageBatch(images=(*part(0).images, *part(1, data=TORN).images, *part(2).images))
    with pytest.raises(DamagedImageError) as refused:
        await bring(session, sent, IMAGE + TORN + IMAGE)
    assert Refusal.of_error(refused.value).damaged == (1,)
    await bring(session, part(0, 2, 3), 3 * IMAGE)
    gap = MissingRun(first=1, count=1, reason="its image is damaged: cut off")
    await session.accept_report(report("a").with_plan(picked=4, missing_runs=(gap,)), 0)
    manifest = whole(session.folder).manifest
    assert [image.instant for image in manifest.images] == [0, 2, 3]
    assert [(gap.instant, gap.reason) for gap in manifest.missing] == [(1, "its image is damaged: cut off")]


@pytest.mark.parametrize("data", [IMAGE + OTHER, IMAGE], ids=["other bytes", "too few"])
async def test_what_is_damaged_on_its_way_is_asked_for_again(tmp_path: Path, data: bytes) -> None:
    session = recording_of(tmp_path, "a")
    await begin(session, "a")
    same = small_jpeg(b"a picture of some lengtH")
    sent = ImageBatch(images=(*part(0).images, *part(1, data=same).images))
    with pytest.raises(TryAgainError):
        await bring(session, sent, data[: 2 * len(IMAGE)])
    assert session.is_empty()
    await session.suspend()


async def test_another_image_in_place_of_a_saved_one_is_not_acknowledged(tmp_path: Path) -> None:
    session = recording_of(tmp_path, "a")
    await begin(session, "a")
    await bring(session, part(0), IMAGE)
    with pytest.raises(TryAgainError, match="another image of instant 0"):
        await bring(session, part(0, data=OTHER), OTHER)
    await session.suspend()


async def test_a_part_whose_sync_fails_is_not_acknowledged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = recording_of(tmp_path, "a")
    await begin(session, "a")
    await bring(session, part(0), IMAGE)

    def fail(_: int) -> None:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as failing:
        failing.setattr(os, "fdatasync", fail)
        with pytest.raises(DiskError):
            await bring(session, part(1, 2), 2 * IMAGE)
    assert [session._writer.videos.has("a", instant) for instant in range(3)] == [True, False, False]
    await session.finish_now("its disk failed")
    assert [image.instant for image in whole(session.folder).manifest.images] == [0]


async def test_a_batch_has_images_of_one_camera(tmp_path: Path) -> None:
    session = recording_of(tmp_path, "a", "b")
    await begin(session, "a", "b")
    with pytest.raises(BadInputError):
        await session.take(ImageBatch(images=(upload("a", 0), upload("b", 0))), pieces(IMAGE), 0)
    await session.suspend()


async def test_an_instant_that_comes_twice_in_a_part_is_saved_once(tmp_path: Path) -> None:
    session = recording_of(tmp_path, "a", frames=3)
    await begin(session, "a")
    await bring(session, part(0, 1, 1), 3 * IMAGE)
    with pytest.raises(TryAgainError, match="another image of instant 2"):
        await bring(session, ImageBatch(images=(*part(2).images, *part(2, data=OTHER).images)), IMAGE + OTHER)
    await bring(session, part(2), IMAGE)
    await session.accept_report(report("a").with_plan(picked=3), 0)
    assert [image.instant for image in whole(session.folder).manifest.images] == [0, 1, 2]


@pytest.mark.parametrize("twice", [1, 2], ids=["within", "at the end"])
async def test_repair_mends_a_film_that_has_an_instant_twice(tmp_path: Path, twice: int) -> None:
    """As leaders wrote it before they refused the second copy."""
    session = recording_of(tmp_path, "a", frames=3)
    await session.write_plan(LEADER)
    await begin(session, "a")
    for instant in range(3):
        await bring(session, part(instant), IMAGE)
        if instant == twice:
            await asyncio.sleep(0)
            video = session._writer.videos._videos["a"][-1]
            copy = StoredImage(part(instant, data=OTHER).images[0].record, memoryview(OTHER))
            line = frame_line(copy.record, video.end, None)
            os.pwrite(video.handle, OTHER, video.end)
            video.lines.append(line, durable=True)
            video.note(instant, len(line) + 1, video.end + len(OTHER))
    await session.accept_report(report("a").with_plan(picked=3), 0)
    problems = [str(problem) for problem in verify(Session.open(session.folder))]
    assert any(f"2 images of a at instant {twice}" in problem for problem in problems)
    await repair(session.folder, wait_s=0, address=Address("127.0.0.1", 1), log=Log())
    saved = whole(session.folder)
    assert [saved.image_bytes(image) for image in saved.manifest.images] == 3 * [IMAGE]
