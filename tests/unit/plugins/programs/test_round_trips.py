"""A session that is exported and imported is the session that it was."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from capture_app.cli import run
from capture_app.common.errors import BadInputError, ExitCode
from capture_app.companions.exporting.export_session import export_session
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import ImageRecord
from capture_app.session.reading.decoding import decode_image
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from capture_app.session.writing.session_writer import SessionWriter
from tests.imported import import_one
from tests.project import SAMPLES
from tests.unit.plugins.programs.conftest import Make, make  # noqa: F401 - a fixture
from tests.unit.session.conftest import calibration_of
from tests.unit.session.recorded import record

SAMPLE = SAMPLES / "crossing"
BIT_FOR_BIT = ("colmap", "nerfstudio", "mcap")


def there_and_back(session: Session, to: str, root: Path, **options: Any) -> Session:
    export_session(session, to, root / to)
    return import_one([str(root / to)], root / "back", to, ImportOptions(**options))


def times_of(image: ImageRecord) -> ImageRecord:
    """The record without what a video cannot keep: the bytes."""
    return msgspec.structs.replace(image, path="", bytes=1, sha256="0" * 64)


def pixels(session: Session, image: ImageRecord) -> np.ndarray[Any, Any]:
    found = decode_image(session.image_bytes(image), colour=True)
    assert found is not None
    return found


@pytest.mark.parametrize("to", BIT_FOR_BIT)
def test_a_sample_comes_back_bit_for_bit(to: str, tmp_path: Path) -> None:
    taken = Session.open(SAMPLE)
    again = there_and_back(taken, to, tmp_path, note=taken.manifest.note)
    assert verify(again) == []
    expected = msgspec.structs.replace(taken.manifest, name=to, software=again.manifest.software)
    assert again.manifest == expected
    assert again.calibration() == taken.calibration()
    for image in taken.manifest.images:
        assert again.image_file(image).read_bytes() == taken.image_file(image).read_bytes()


VIDEOS = ("pose2sim", "easymocap", "freemocap", "caliscope", "mp4")
OF_INSTANTS = ("colmap", "pose2sim", "easymocap", "freemocap")
"""Formats that have no place for an image of another moment."""


@pytest.mark.parametrize("to", [*BIT_FOR_BIT, *VIDEOS])
def test_gaps_and_substitutes_come_back(make: Make, to: str, tmp_path: Path) -> None:  # noqa: F811
    """A frame may stand for two instants."""
    taken = make()
    again = there_and_back(taken, to, tmp_path)
    assert verify(again) == []
    before = {(image.camera, image.instant): image for image in taken.manifest.images}
    after = {(image.camera, image.instant): image for image in again.manifest.images}
    lost = set(before) - set(after)
    assert all(before[place].substitute for place in lost)
    assert bool(lost) == (to in OF_INSTANTS)
    assert [times_of(after[at]) for at in after] == [times_of(before[at]) for at in before if at in after]
    gone = {(one.camera, one.instant): one for one in again.manifest.missing}
    for one in taken.manifest.missing:
        assert gone[one.camera, one.instant] == one
    assert all(gone[place].reason == "the export does not have it" for place in lost)
    assert again.calibration() == taken.calibration()


def test_lossless_videos_come_back_pixel_for_pixel(make: Make, tmp_path: Path) -> None:  # noqa: F811
    taken = make()
    export_session(taken, "mp4", tmp_path / "out", lossless=True)
    again = import_one([str(tmp_path / "out")], tmp_path, "s", ImportOptions(png=True))
    before = {(image.camera, image.instant): image for image in taken.manifest.images}
    for image in again.manifest.images:
        assert np.array_equal(pixels(again, image), pixels(taken, before[image.camera, image.instant]))


@pytest.mark.parametrize("to", ["colmap", "mcap", "pose2sim"])
def test_a_recordings_frames_come_back_as_images(to: str, tmp_path: Path) -> None:
    taken = record(SessionWriter.create(tmp_path, "recording"))
    if to == "pose2sim":
        taken = with_calibration(taken)
    again = there_and_back(taken, to, tmp_path)
    assert verify(again) == []
    assert again.manifest.videos == ()
    before = {(image.camera, image.instant): image for image in taken.manifest.images}
    assert len(again.manifest.images) == len(before)
    for image in again.manifest.images:
        original = before[image.camera, image.instant]
        assert (image.leader_ns, image.local_ns) == (original.leader_ns, original.local_ns)
        if to != "pose2sim":
            assert again.image_bytes(image) == taken.image_bytes(original)
    assert again.manifest.missing == taken.manifest.missing


def with_calibration(session: Session) -> Session:
    camera = calibration_of("left").cameras["left"]
    cameras = {name: msgspec.structs.replace(camera, width=32, height=24) for name in ("left", "right")}
    (session.folder / "calibration.json").write_bytes(msgspec.json.encode(Calibration(cameras=cameras)))
    return Session.open(session.folder)


def test_some_instants_and_a_lone_file(tmp_path: Path) -> None:
    taken = Session.open(SAMPLE)
    some = there_and_back(taken, "nerfstudio", tmp_path, start=1, count=3)
    assert [image.leader_ns for image in some.manifest.images] == [
        image.leader_ns for image in taken.manifest.images if 1 <= image.instant <= 3
    ]
    assert some.manifest.burst.instants_ns == taken.manifest.burst.instants_ns[1:4]
    assert some.manifest.origin == taken.manifest.origin
    there_and_back(taken, "mcap", tmp_path)
    (file,) = (tmp_path / "mcap").glob("*.mcap")
    out = str(tmp_path / "lone")
    assert run(["sessions", "import", str(file), "--out", out, "--name", "lone"]) == ExitCode.OK
    lone = Session.open(tmp_path / "lone" / "lone")
    assert lone.manifest.images == taken.manifest.images
    assert lone.calibration() == taken.calibration()


def test_a_changed_picture_makes_it_an_import(tmp_path: Path) -> None:
    taken = Session.open(SAMPLE)
    export_session(taken, "colmap", tmp_path / "out")
    images = sorted((tmp_path / "out" / "images").rglob("*.jpg"))
    images[0].write_bytes(images[1].read_bytes())
    images[2].unlink()
    again = import_one([str(tmp_path / "out")], tmp_path, "s", ImportOptions())
    assert again.manifest.origin == "imported"
    assert len(again.manifest.images) == len(taken.manifest.images) - 1
    assert verify(again) == []


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda out: (out / "frames.csv").unlink(), "cannot read .*frames.csv"),
        (
            lambda out: (out / "frames.csv").write_text("file,content\na,image\n"),
            "not the table of an export",
        ),
        (lambda out: (out / "simulshot.json").write_text("{}"), "simulshot.json"),
        (lambda out: (out / "images" / "cam00" / "000000.jpg").write_bytes(b"x"), "not an image"),
    ],
)
def test_broken_exports_say_why(tmp_path: Path, change: Any, reason: str) -> None:
    export_session(Session.open(SAMPLE), "nerfstudio", tmp_path / "out")
    change(tmp_path / "out")
    with pytest.raises(BadInputError, match=reason):
        import_one([str(tmp_path / "out")], tmp_path, "s", ImportOptions())
    assert not (tmp_path / "s").exists()


def test_an_export_cannot_lead_out_of_its_folder(tmp_path: Path) -> None:
    export_session(Session.open(SAMPLE), "nerfstudio", tmp_path / "out")
    table = tmp_path / "out" / "frames.csv"
    table.write_text(table.read_text().replace("images/cam00/000000.jpg", "../secret.jpg"))
    with pytest.raises(BadInputError, match="outside"):
        import_one([str(tmp_path / "out")], tmp_path, "s", ImportOptions())


def test_times_of_the_session_are_not_shifted(tmp_path: Path) -> None:
    export_session(Session.open(SAMPLE), "colmap", tmp_path / "out")
    with pytest.raises(BadInputError, match="--time-shift-ms"):
        import_one([str(tmp_path / "out")], tmp_path, "s", ImportOptions(offsets_ms={"cam00": 5.0}))
