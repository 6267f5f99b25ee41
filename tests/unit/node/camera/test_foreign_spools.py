"""Spools of earlier versions are delivered; what no node of this version wrote stays, and is named."""

import os
import shutil
from pathlib import Path

import pytest

from capture_app.common.errors import SimulshotError
from capture_app.machine import doctor
from capture_app.net.channel import Channel
from capture_app.node.camera.burst_upload import encode_frame
from capture_app.node.camera.film_spool import SpooledFilm
from capture_app.node.camera.spool import Spool
from capture_app.protocol.messages import ToLeader
from tests.images import small_jpeg
from tests.unit.node.bursts import IMAGE, upload
from tests.unit.node.camera.uploading import Picture, burst_upload, images, uploading
from tests.waiting import until

SPOOLS = Path(__file__).parent / "spools"
"""Spools with three images of a camera each, as nodes of these protocols wrote them."""
NAME = "00000001-000001"


async def delivered(spool: Path, *, count: int = 3) -> tuple[dict[int, bytes], list[str]]:
    """Run a node with that spool until so many images have arrived and nothing more is sent."""
    stored: dict[int, bytes] = {}
    said: list[str] = []

    async def serve(channel: Channel[ToLeader]) -> None:
        async for image, payload in images(channel):
            stored[image.record.instant] = payload

    async with uploading(serve, said, Spool(spool, "a")) as uploader:
        await until(lambda: len(stored) == count and not uploader._bursts)
    return stored, said


def everything_in(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


@pytest.mark.parametrize("protocol", [7, 8])
async def test_a_spool_of_an_earlier_protocol_is_delivered(tmp_path: Path, protocol: int) -> None:
    spool = shutil.copytree(SPOOLS / f"protocol-{protocol}", tmp_path / "spool")
    stored, said = await delivered(spool)
    assert stored == {n: small_jpeg(text) for n, text in enumerate((b"zero", b"one", b"two"))}
    assert [*(spool / "a").iterdir()] == []
    assert not any("left alone" in line for line in said)


def test_new_frames_beside_images_of_an_earlier_protocol_keep_their_index(tmp_path: Path) -> None:
    """The image of instant 1 and the first segment have one number: its index went with that image."""
    film = SpooledFilm(shutil.copytree(SPOOLS / "protocol-7/a" / NAME, tmp_path / NAME))
    assert [frame.record.instant for frame in film.recover()] == [0, 1, 2]
    film.append([(upload("a", 3), IMAGE)])
    assert (tmp_path / NAME / "000001.ndjson").exists()
    assert film.release([1]) == [tmp_path / NAME / "000001.jpg"]
    film.close()


@pytest.mark.parametrize("protocol", [7, 8])
async def test_foreign_files_stay_and_are_named(tmp_path: Path, protocol: int) -> None:
    spool = shutil.copytree(SPOOLS / f"protocol-{protocol}", tmp_path / "spool")
    foreign = {
        f"a/{NAME}/notes.txt": b"mine",
        f"a/{NAME}/holiday.jpg": b"a picture",
        "a/keep/report.json": b"{}",
        "a/readme": b"?",
    }
    for name, data in foreign.items():
        (spool / name).parent.mkdir(exist_ok=True)
        (spool / name).write_bytes(data)
    _, said = await delivered(spool)
    assert everything_in(spool) == foreign
    (line,) = (line for line in said if "left alone" in line)
    assert all(name in line for name in (f"{NAME}/notes.txt", f"{NAME}/holiday.jpg", "a/keep", "a/readme"))
    (found, *_) = doctor.spooled(spool)
    assert found.text.startswith("3 files that no node of this version wrote")


async def test_nothing_behind_a_link_is_read_moved_or_deleted(tmp_path: Path) -> None:
    """A link in the spool emptied a folder of the user's, and one in the next spool lost its bursts."""
    outside, spool = tmp_path / "outside", tmp_path / "spool"
    shutil.copytree(SPOOLS / "protocol-7" / "a", outside)
    (outside / NAME / "thesis.txt").write_bytes(b"years of work")
    before = everything_in(outside)
    (spool / ".2").mkdir(parents=True)
    (spool / "a").mkdir()
    (spool / "a" / NAME).symlink_to(outside / NAME)
    (spool / ".2" / "a").symlink_to(outside)
    stored, said = await delivered(spool, count=0)
    assert stored == {}
    assert everything_in(outside) == before
    assert any("left alone" in line and NAME in line for line in said)
    using = Spool(spool, "a")
    using.open()
    upload = burst_upload(Picture(b"zero"))
    with pytest.raises(SimulshotError):
        using.create_burst(upload.report)
    using.close()
    assert everything_in(outside) == before


@pytest.mark.parametrize("of", ["another camera", "another burst"])
async def test_a_report_of_another_burst_is_not_taken_for_ones_own(tmp_path: Path, of: str) -> None:
    spool, camera = tmp_path / "spool", "b" if of == "another camera" else "a"
    folder = shutil.copytree(SPOOLS / "protocol-8/a" / NAME, spool / ".2" / camera / NAME)
    if of == "another burst":
        folder.rename(folder.with_name("00000001-000002"))
    before = everything_in(spool)
    using = Spool(spool, camera)
    assert using.open() == []
    using.close()
    assert everything_in(spool) == before


@pytest.mark.parametrize("what", ["a newer index", "a newer report", "a pipe"])
async def test_what_is_not_understood_stays(tmp_path: Path, what: str) -> None:
    spool = shutil.copytree(SPOOLS / "protocol-8", tmp_path / "spool")
    folder = spool / "a" / NAME
    index = folder / "000001.ndjson"
    if what == "a newer index":
        index.write_bytes(b'{"at":0,"size":31}\n')
    elif what == "a newer report":
        (folder / "report.json").write_bytes(b'{"type":"report-9"}')
    else:
        index.unlink()
        os.mkfifo(index)
    before = {file.name for file in folder.iterdir()}
    stored, said = await delivered(spool, count=0)
    assert stored == {}
    assert {file.name for file in folder.iterdir()} == before
    assert any(str(folder) in line for line in said)


@pytest.mark.parametrize("protocol", [7, 8])
async def test_what_is_readable_is_delivered_once_and_the_rest_stays(tmp_path: Path, protocol: int) -> None:
    """A damaged line lost its image with the others', or had them offered again at each start."""
    spool = shutil.copytree(SPOOLS / f"protocol-{protocol}", tmp_path / "spool")
    folder = spool / "a" / NAME
    index, film = (
        folder / ("journal.ndjson" if protocol == 7 else "000001.ndjson"),
        folder / ("000001.jpg" if protocol == 7 else "000001.film"),
    )
    first, _, last = index.read_bytes().splitlines(keepends=True)
    index.write_bytes(first + b"damaged\n" + last + b"torn")
    image = film.read_bytes()
    stored, said = await delivered(spool, count=2)
    assert stored == {0: small_jpeg(b"zero"), 2: small_jpeg(b"two")}
    assert {file.name for file in folder.iterdir()} == {"report.json", index.name, film.name}
    assert (index.read_bytes(), film.read_bytes()) == (b"damaged\ntorn", image)
    assert any("left alone" in line and str(index) in line for line in said)
    (found, *_) = doctor.spooled(spool)
    assert str(index) in found.text
    before = everything_in(spool)
    stored, said = await delivered(spool, count=0)
    assert stored == {}
    assert not any("still in" in line for line in said)
    assert any("left alone" in line and str(index) in line for line in said)
    assert everything_in(spool) == before


def test_frames_that_a_power_cut_tore_are_not_taken_for_foreign_ones(tmp_path: Path) -> None:
    spool = Spool(tmp_path, "a")
    spool.open()
    upload = burst_upload(Picture(b"zero"))
    burst = spool.create_burst(upload.report)
    burst.add([encode_frame(upload.report, upload.frames[0])])
    index = burst.folder / "000001.ndjson"
    index.write_bytes(index.read_bytes()[:50])
    assert [*burst.film.recover()] == []
    assert burst.remove()
    assert [*spool.folder.iterdir()] == []
    spool.close()
