"""Readers of recordings, calibrations and exports of other programs."""

import shutil
from contextlib import suppress
from pathlib import Path

import msgspec

from capture_app.common.errors import SimulshotError
from capture_app.companions.exporting.export_session import export_session
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.companions.importing.times.tables import timeline_by_tables
from capture_app.plugins.footage.gopro import parse_payload, read_gps_clock
from capture_app.plugins.footage.sound import read_sound
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import CALIBRATION
from capture_app.session.importing.calibrations import read_views
from capture_app.session.importing.importer import open_sources
from capture_app.session.reading.decoding import decode_image, read_exif, size_of
from capture_app.session.reading.reader import Session
from tests.fuzz.folders import Reader, contents, put, small_session
from tests.imported import import_one
from tests.unit.session.conftest import calibration_of, jpeg


def read_picture(data: bytes, folder: Path) -> None:
    """A picture: its size by its header, its EXIF, its pixels."""
    size_of(data)
    with suppress(ValueError):
        read_exif(data)
    decode_image(data, colour=True)


def import_file(name: str) -> Reader:
    """A recording, by its file's name: opened, timed, its first frames taken."""

    def read(data: bytes, folder: Path) -> None:
        path = folder / "camera" / name
        put(path, data)
        with suppress(SimulshotError):
            for source in open_sources([f"a={path if path.suffix != '.jpg' else path.parent}"]):
                source.embedded_times()
                for _ in source.frames(range(1)):
                    pass

    return read


def import_whole(name: str) -> Reader:
    """A recording of all cameras in one file, imported."""

    def read(data: bytes, folder: Path) -> None:
        put(folder / name, data)
        with suppress(SimulshotError):
            import_one([str(folder / name)], folder, "imported", ImportOptions())

    return read


def read_sound_file(data: bytes, folder: Path) -> None:
    """The sound of a recording, as alignment reads it."""
    path = folder / "sound.wav"
    put(path, data)
    with suppress(SimulshotError):
        read_sound(path)


def read_gopro(data: bytes, folder: Path) -> None:
    """GoPro metadata: a payload of it, and a video with a track of it."""
    parse_payload(data)
    path = folder / "video.mp4"
    put(path, data)
    with suppress(SimulshotError):
        read_gps_clock(path)


def read_table(data: bytes, folder: Path) -> None:
    """A table of the frames' times."""
    path = folder / "times.csv"
    path.write_bytes(data)
    for camera in "ab":
        for number in range(3):
            put(folder / camera / f"{number}.jpg", jpeg(number))
    with suppress(SimulshotError):
        timeline_by_tables(open_sources([f"{camera}={folder / camera}" for camera in "ab"]), [("", path)])


def read_calibration(name: str) -> Reader:
    """A calibration of another program, by its file's name."""

    def read(data: bytes, folder: Path) -> None:
        put(folder / name, data)
        with suppress(SimulshotError):
            read_views([("", folder / name)], ("left", "right"))

    return read


def read_sidecar(data: bytes, folder: Path) -> None:
    """RealityCapture's XMP beside its image."""
    put(folder / "left.jpg", jpeg(0))
    read_calibration("left.xmp")(data, folder)


def read_rig(name: str) -> Reader:
    """A folder with the calibration of a whole rig, by the name of one file of it."""

    def read(data: bytes, folder: Path) -> None:
        for other in (name, name.replace("intri", "extri").replace("cameras", "images")):
            put(folder / other, data)
        with suppress(SimulshotError):
            read_views([("", folder)], ("left", "right"))

    return read


def import_exported(to: str, name: str) -> Reader:
    """An export of a session in which one file is whatever a stranger made of it, imported again."""

    def read(data: bytes, folder: Path) -> None:
        if to not in _exports:
            taken = small_session(folder)
            cameras = {name: calibration_of(name).cameras[name] for name in ("left", "right")}
            put(taken / CALIBRATION, msgspec.json.encode(Calibration(cameras=cameras)))
            session = Session.open(taken)
            export_session(session, to, folder / "made")
            _exports[to] = contents(folder / "made")
            shutil.rmtree(folder / "made")
        export = folder / "export"
        for path, content in _exports[to].items():
            put(export / path, content)
        assert (export / name).is_file()
        put(export / name, data)
        with suppress(SimulshotError):
            import_one([str(export)], folder, "imported", ImportOptions())

    return read


_exports: dict[str, dict[Path, bytes]] = {}
