"""A burst's folder in the spool, which the encoder writes while the sender takes it away."""

import asyncio
import errno
import os
import threading
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from msgspec.structs import replace

from capture_app.common.errors import BadInputError, DiskFullError, TryAgainError
from capture_app.common.tasks import end
from capture_app.node.camera import spool
from capture_app.node.camera.burst_upload import encode_frame
from capture_app.node.camera.spool import Spool, SpoolFolder, free_spool
from capture_app.node.camera.uploader import Uploader
from capture_app.protocol.log import Log
from capture_app.protocol.messages import CameraReport
from capture_app.session.files import durable
from tests.unit.node.camera.test_film_duty import open_files
from tests.unit.node.camera.uploading import Picture, burst_upload
from tests.waiting import until

UPLOAD = burst_upload(Picture(b"zero"))


def write_report(burst: SpoolFolder, report: CameraReport) -> None:
    burst.write_report(report)


def add_image(burst: SpoolFolder, report: CameraReport) -> None:
    burst.add([encode_frame(report, UPLOAD.frames[0])])


def spool_with_an_image(root: Path) -> tuple[Spool, SpoolFolder]:
    """Return the open spool of camera a, and its one burst."""
    opened = Spool(root, "a")
    opened.open()
    burst = opened.create_burst(UPLOAD.report)
    add_image(burst, UPLOAD.report)
    return opened, burst


@pytest.mark.parametrize("write", [write_report, add_image])
def test_what_is_written_while_a_burst_is_removed_is_not_left_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: Callable[[SpoolFolder, CameraReport], None]
) -> None:
    """The writer comes when all files are deleted, and the folder is not: it would stay with that file."""
    spool = Spool(tmp_path, "a")
    spool.open()
    burst = spool.create_burst(UPLOAD.report)
    writer = threading.Thread(target=write, args=(burst, UPLOAD.report))
    remove_folder = os.rmdir

    def rmdir(path: str, *, dir_fd: int | None = None) -> None:
        writer.start()
        writer.join(0.2)
        remove_folder(path, dir_fd=dir_fd)

    with monkeypatch.context() as patch:
        patch.setattr(os, "rmdir", rmdir)
        burst.remove()
    writer.join()
    spool.close()
    assert not list((tmp_path / "a").iterdir())


def test_what_a_failing_disk_does_not_delete_goes_when_it_is_usable_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spool, burst = spool_with_an_image(tmp_path)

    def fail(path: Path, missing_ok: bool = False) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", fail)
        spool.remove(burst)
        assert spool.look().problem
        assert burst.folder.exists()
    assert not spool.look().problem
    assert not burst.folder.exists()
    spool.close()


@pytest.mark.parametrize("deleted", range(3))
def test_what_a_burst_still_has_when_its_deletion_ends_early_is_deleted_by_the_next_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, deleted: int
) -> None:
    """Of a burst without its report nobody would know whose images they are."""
    spool, burst = spool_with_an_image(tmp_path)
    unlink, left = Path.unlink, iter(range(deleted))

    def delete(path: Path, missing_ok: bool = False) -> None:
        if next(left, None) is None:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        unlink(path, missing_ok)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", delete)
        assert not burst.remove()
    spool.close()
    again = Spool(tmp_path, "a")
    (found,) = again.open()
    assert found.read_report() == UPLOAD.report
    assert found.remove()
    assert not burst.folder.exists()
    again.close()


def test_what_a_failing_disk_did_not_delete_of_a_recording_that_goes_on_is_not_deleted_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder of what the leader had was deleted with what the camera took since, of one recording."""
    spool = Spool(tmp_path, "a")
    spool.open()
    burst = spool.create_burst(UPLOAD.report)
    with monkeypatch.context() as patch:
        patch.setattr(SpoolFolder, "remove", lambda _: False)
        spool.remove(burst)
    further = spool.create_burst(UPLOAD.report)
    add_image(further, UPLOAD.report)
    assert not spool.look().problem
    assert len([*SpoolFolder(further.folder).film.recover()]) == 1
    spool.close()


@pytest.mark.virtual
async def test_what_a_killed_run_wrote_is_synced_by_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was in the machine's memory alone, and a power cut afterwards lost it: no leader need be there."""
    left, burst = spool_with_an_image(tmp_path)
    left.close()
    synced = list[Path]()

    def sync_all(paths: Iterable[Path]) -> dict[Path, OSError]:
        synced.extend(paths)
        return durable.sync_all(synced)

    monkeypatch.setattr(spool, "sync_all", sync_all)
    again = Spool(tmp_path, "a")
    uploader = Uploader("a", 1, Log(), again)
    uploader.load_spool()
    running = asyncio.create_task(uploader.run())
    await until(lambda: synced)
    assert {burst.folder / name for name in ("report.json", "000001.film", "000001.ndjson")} <= {*synced}
    await end(running)
    await uploader.aclose()
    again.close()


def test_a_node_that_is_started_again_begins_with_the_burst_it_wrote_first(tmp_path: Path) -> None:
    spool = Spool(tmp_path, "a")
    spool.open()
    for number, written_s in ((1, 20), (2, 10), (3, 30)):
        burst = spool.create_burst(replace(UPLOAD.report, burst=number))
        os.utime(burst.folder, (written_s, written_s))
    spool.close()
    again = Spool(tmp_path, "a")
    assert [burst.read_report().burst for burst in again.open()] == [2, 1, 3]
    again.close()


def left_by(spool: Path, number: int) -> Spool:
    """A spool as a node of the camera a uses it, with a burst of that number."""
    using = Spool(free_spool(spool, "a"), "a")
    using.open()
    using.create_burst(replace(UPLOAD.report, burst=number))
    return using


def test_bursts_of_ended_nodes_are_moved_to_one_that_runs(tmp_path: Path) -> None:
    first = left_by(tmp_path, 1)
    second, third = left_by(tmp_path, 2), left_by(tmp_path, 3)
    assert [of.folder.parent for of in (first, second, third)] == [tmp_path, tmp_path / ".2", tmp_path / ".3"]
    assert free_spool(tmp_path, "b") == tmp_path
    assert second.adopt() == [], "their nodes run"
    first.close()
    left = next(report.parent.name for report in (tmp_path / "a").glob("*/report.json"))
    assert second.adopt({left}) == [], "it is under way here, and two uploads would write into one folder"
    assert [burst.folder.parent for burst in second.adopt()] == [second.folder]
    third.close()
    assert free_spool(tmp_path, "a") == tmp_path
    again = Spool(tmp_path, "a")
    assert [burst.read_report().burst for burst in again.open()] == [3]
    # What a node has both here and there is not mixed.
    again.create_burst(replace(UPLOAD.report, burst=2))
    second.close()
    assert [burst.read_report().burst for burst in again.adopt()] == [1]
    assert [path.name for path in (tmp_path / ".2/a").iterdir()] == ["00000001-000002"]
    again.close()


def test_a_burst_whose_rest_is_not_its_nodes_counts_as_deleted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a node tries to delete it with each look at its disk, for as long as it runs."""
    before = open_files()
    spool, burst = spool_with_an_image(tmp_path)
    (burst.folder / "notes.txt").write_text("mine")

    def fail(path: Path, missing_ok: bool = False) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", fail)
        assert not burst.remove(), "the film is still there"
    assert burst.remove()
    assert [path.name for path in burst.folder.iterdir()] == ["notes.txt"]
    assert burst.remove()
    spool.close()
    assert open_files() == before


def test_a_folder_without_images_or_report_is_removed_and_a_foreign_one_stays(tmp_path: Path) -> None:
    """As a node leaves one that is killed while it makes or removes it."""
    empty, torn, foreign = (tmp_path / f"a/00000001-00000{n}" for n in (1, 2, 3))
    for folder in (empty, torn, foreign):
        folder.mkdir(parents=True)
    (torn / "report.json.part").write_bytes(b"{")
    (foreign / "000001.film").write_bytes(b"an image")
    (tmp_path / "a/00000001-000004").write_bytes(b"a file")
    spool = Spool(tmp_path, "a")
    assert spool.open() == []
    assert {path.name for path in spool.folder.iterdir()} == {foreign.name, "00000001-000004"}
    spool.close()


def test_only_one_node_uses_a_spool_and_each_may_close_it_twice(tmp_path: Path) -> None:
    first, second = Spool(tmp_path, "a"), Spool(tmp_path, "a")
    second.close()
    first.open()
    with pytest.raises(TryAgainError, match="another node uses the spool"):
        second.open()
    first.close()
    # A file that has the closed one's number is another's.
    other = os.open(tmp_path, os.O_RDONLY)
    first.close()
    os.close(other)
    second.open()
    second.close()


def test_a_spool_that_is_a_file_is_refused_with_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"")
    with pytest.raises(BadInputError, match="cannot use the spool") as refused:
        Spool(tmp_path, "a").open()
    assert refused.value.hint == "choose another with --spool"


@pytest.mark.parametrize(
    "what", ["a link to a spool", "a burst without a report", "a link in the place of one"]
)
def test_what_another_spool_has_that_is_not_a_burst_stays_there(tmp_path: Path, what: str) -> None:
    using, left = Spool(tmp_path, "a"), Spool(tmp_path / ".2", "a")
    using.open()
    left.open()
    bursts = [left.create_burst(replace(UPLOAD.report, burst=number)).folder for number in (1, 2)]
    left.close()
    if what == "a link to a spool":
        left.folder.rename(tmp_path / "elsewhere")
        left.folder.symlink_to(tmp_path / "elsewhere")
    elif what == "a burst without a report":
        (bursts[0] / "report.json").unlink()
    else:
        (using.folder / bursts[0].name).symlink_to(tmp_path / "gone")
    moved = [burst.folder.name for burst in using.adopt()]
    assert moved == ([] if what == "a link to a spool" else [bursts[1].name])
    assert {path.name for path in left.folder.iterdir()} == {path.name for path in bursts} - {*moved}
    using.close()


@pytest.mark.parametrize("name", [".2", "2", ".spool", "spool"])
def test_a_spool_may_be_any_folder(tmp_path: Path, name: str) -> None:
    """Of SPOOL/.2 the first is SPOOL itself, and the one after it SPOOL/.3."""
    first = Spool(free_spool(tmp_path / name, "a"), "a")
    first.open()
    assert first.folder == (tmp_path if name == ".2" else tmp_path / name) / "a"
    assert free_spool(tmp_path / name, "a") == first.folder.parent / ".2"
    first.close()


def test_a_full_disk_leaves_no_part_of_a_burst_and_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = Spool(tmp_path, "a")
    opened.open()

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(spool, "write_atomic", full)
        patch.setattr(spool, "reserve", full)
        with pytest.raises(DiskFullError):
            opened.create_burst(UPLOAD.report)
        space = opened.look()
    assert [*opened.folder.iterdir()] == []
    assert (space.camera, space.free_bytes, space.spool) == ("a", 0, str(opened.folder))
    assert "full" in space.problem
    assert not opened.look().problem
    opened.close()
