"""The virtual disk loses what was not synced, and nothing else; a killed process does nothing more."""

import asyncio
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from capture_app.node.camera.spool import Spool
from capture_app.session.files.durable import AppendOnlyFile, sync_folder, write_atomic
from capture_app.session.writing.session_writer import SessionWriter
from tests.images import small_jpeg
from tests.unit.node.bursts import IMAGE, report, upload
from tests.virtual.world import World


def left(
    *works: Callable[[Path], object], before: Callable[[Path], object] = lambda _: None
) -> dict[str, bytes]:
    """Let processes work in a folder, each killed in turn, cut the power, and return the files by name."""
    world = World(1)
    folder = world.disks.of("machine").folder
    before(folder)
    world.disks.settle("machine")

    async def process(work: Callable[[Path], object]) -> None:
        work(folder)
        await asyncio.sleep(1)

    async def evening() -> None:
        for work in works:
            world.start("process", "machine", partial(process, work))
            await asyncio.sleep(0.5)
            await world.kill("process")

    try:
        with world.entered():
            world.run(evening())
        world.disks.cut_power("machine")
        return {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    finally:
        world.disks.remove()


def test_a_file_that_is_written_atomically_survives() -> None:
    assert left(lambda folder: write_atomic(folder / "a", b"new")) == {"a": b"new"}


def test_a_file_without_a_sync_is_lost() -> None:
    assert left(lambda folder: write_atomic(folder / "a", b"new", synced=False)) == {}


def test_a_rename_that_is_not_synced_leaves_the_old_file() -> None:
    def replace(folder: Path) -> None:
        write_atomic(folder / "a", b"new", synced=False)

    files = left(replace, before=lambda folder: (folder / "a").write_bytes(b"old"))
    assert files == {"a": b"old"}


def test_lines_survive_if_they_are_durable() -> None:
    def append(folder: Path) -> None:
        file = AppendOnlyFile(folder / "lines")
        sync_folder(folder)
        file.append(b"one", durable=True)
        file.append(b"two", durable=False)

    assert left(append) == {"lines": b"one\n"}


def test_a_deleted_file_comes_back_without_a_sync() -> None:
    assert left(lambda folder: (folder / "a").unlink(), before=lambda f: f.joinpath("a").touch()) == {
        "a": b""
    }


def test_folders_that_a_killed_writer_did_not_sync_are_synced_by_the_next() -> None:
    def begin(folder: Path) -> None:
        SessionWriter.create(folder, "burst-001")
        (folder / "burst-001" / "images" / "rig1" / "a").mkdir(parents=True)

    def go_on(folder: Path) -> None:
        writer = SessionWriter(folder / "burst-001", "burst-001")
        writer.add_image(small_jpeg(), camera="a", instant=0, leader_ns=0)

    assert "000000.jpg" in left(begin, go_on)


def test_images_in_the_folder_of_a_new_spool_survive() -> None:
    def keep(folder: Path) -> None:
        spool = Spool(folder / "state" / "spool", "a")
        spool.open()
        burst = spool.create_burst(report("a", 0))
        burst.add([(upload("a", 0), IMAGE)])
        burst.sync()

    assert left(keep)["000001.film"] == IMAGE


@pytest.mark.parametrize("steps", range(1, 6))
def test_a_process_is_killed_in_the_middle_of_its_work(steps: int) -> None:
    world = World(1)
    folder = world.disks.of("machine").folder
    ended = []

    async def process() -> None:
        world.disks.kill_after[world.processes["process"]] = steps
        for number in range(9):
            write_atomic(folder / str(number), b"data")

    async def evening() -> None:
        world.on_end = lambda one, error: ended.append((one.name, error))
        world.start("process", "machine", process)
        await asyncio.sleep(1)

    try:
        with world.entered():
            world.run(evening())
        assert ended == [("process", None)]
        assert len(list(folder.iterdir())) <= steps
    finally:
        world.disks.remove()


@pytest.mark.parametrize("steps", range(1, 22))
def test_a_node_finds_again_what_it_was_killed_in_the_middle_of(steps: int) -> None:
    world = World(1)
    folder = world.disks.of("machine").folder
    ended: list[Exception | None] = []
    left_over: list[Path] = []

    async def make_and_remove() -> None:
        spool = Spool(folder, "a")
        spool.open()
        world.disks.kill_after[world.processes["node"]] = steps
        burst = spool.create_burst(report("a", 0, 1))
        for instant in range(2):
            burst.add([(upload("a", instant), IMAGE)])
        burst.remove()

    async def look() -> None:
        found = {burst.folder for burst in Spool(folder, "a").open()}
        left_over.extend(path for path in (folder / "a").iterdir() if path.is_dir() and path not in found)

    async def evening() -> None:
        world.on_end = lambda _, error: ended.append(error)
        for work in (make_and_remove, look):
            world.start("node", "machine", work)
            await asyncio.sleep(1)
            await world.kill("node")

    try:
        with world.entered():
            world.run(evening())
    finally:
        world.disks.remove()
    # Killed by its disk, or not at all.
    assert ended in ([], [None])
    assert left_over == []
