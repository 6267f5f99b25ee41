"""Image index: the images of each camera, and the time of every image in index.json."""

from pathlib import Path

import msgspec

from capture_app.common.errors import BadInputError
from capture_app.session.files.untrusted_files import read_text
from capture_app.session.format.manifest import inside
from capture_app.session.importing.frame_matching import TimedFrame
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.recording_sources import Images, Layout


class Entry(msgspec.Struct):
    """An image's file, CAMERA/NAME, and its time in ns of one clock for all cameras."""

    file: str
    leader_ns: int


def open_recording(path: Path, *, png: bool, recording: str | None) -> Layout | None:
    """The recording in a folder with index.json; None for any other folder."""
    file = path / "index.json"
    if not file.is_file():
        return None
    try:
        index = msgspec.json.decode(read_text(file), type=list[Entry])
    except msgspec.DecodeError as error:
        raise BadInputError(f"{file} is not an image index: {error}") from error
    cameras: dict[str, list[Entry]] = {}
    for entry in sorted(index, key=lambda entry: entry.leader_ns):
        cameras.setdefault(entry.file.partition("/")[0], []).append(entry)
    sources = [
        Images(
            camera,
            path / camera,
            [inside(path, entry.file) for entry in entries],
            "image index",
            times=[TimedFrame(number, entry.leader_ns) for number, entry in enumerate(entries)],
        )
        for camera, entries in cameras.items()
    ]
    return Layout(path=path, sources=tuple(sources))


IMPORTER = Importer(
    program="Image index", help="images and index.json with their times", open_recording=open_recording
)
