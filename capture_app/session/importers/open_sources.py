"""Opens the cameras of a recording that a user named: images, videos, or phones with the leader's times.

libsoftwaresync writes for each shot sync_metadata_TIME.txt (leader_sensor_timestamp_ns and
local_sensor_timestamp_ns), and beside it img_TIME.jpg or img_TIME.nv21 with nv21_metadata_TIME.txt, in a
folder for each shot.

RecSync (MobileRoboticsSkoltech/RecSync-android, MainActivity.java and CSVLogger.java) writes on each phone
RecSync/VID/VID_TIME.mp4 and RecSync/TIME.csv: a line a frame, its time by the leader's clock in ns. RecSyncNG
(DFKI-SignLanguage/RecSync-android) writes RecSync/VID/PREFIX_TIME.mp4 and RecSync/PREFIX_TIME.csv there; its
file_server.py collects both in PREFIX/CLIENT/, and its PostProcessVideos.py makes of them CLIENT.mp4 and
CLIENT.csv, whose second column tells frames that were put in (black) where the phone dropped one.
"""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.common.names import check_name, is_name, natural_order
from capture_app.session.files.strangers import read_text
from capture_app.session.format.manifest import IMAGE_SUFFIXES
from capture_app.session.importers.frame_matching import TimedFrame, check_order
from capture_app.session.importers.sources import (
    Images,
    Source,
    Video,
    image_folder,
    images_in,
    upright,
    videos_in,
)
from capture_app.session.reading.decoding import encode_image

_METADATA = "sync_metadata_"
_VIDEOS, _HEADING = "VID", "timestamp"
_LEADER, _LOCAL = "leader_sensor_timestamp_ns", "local_sensor_timestamp_ns"


_Shot = tuple[Path, int, int | None]
"""An image, and when it was taken by the leader's clock and by the phone's, ns."""


def _shots_of(name: str, path: Path) -> Images:
    """The shots of one phone with libsoftwaresync, by the leader's time; JPEG bytes are kept as they are."""
    shots = [shot for file in _metadata_in(path) if (shot := _shot(file)) is not None]
    if not shots:
        raise BadInputError(f"no image in {path} belongs to its sync_metadata files")
    shots.sort(key=lambda shot: shot[1])
    times = [TimedFrame(n, leader_ns, local_ns) for n, (_, leader_ns, local_ns) in enumerate(shots)]
    files = [image for image, _, _ in shots]
    source = Images(name, path, files, "libsoftwaresync", read=_read_shot, times=times)
    source.suffix = ".jpg"
    return source


def _read_shot(file: Path) -> bytes:
    return upright(file.read_bytes()) if file.suffix == ".jpg" else _from_nv21(file)


class PhoneVideo(Video):
    """A video of one phone with RecSync; its table gives each frame's leader time."""

    kind = "RecSync"

    def __init__(self, name: str, path: Path, *, png: bool = False) -> None:
        super().__init__(name, path, png=png)
        table = table_of(path)
        if table is None:
            raise BadInputError(f"{path} has no table of times")
        self._table, self._rows = table, _rows(table)

    def embedded_times(self) -> Sequence[TimedFrame]:
        """When each frame was taken; if table and video differ in length, as many as the shorter has."""
        rows = self._rows[: len(self.numbers)]
        if len(self._rows) != len(self.numbers):
            of = f"{len(self._rows)} times for {len(self.numbers)} frames"
            self.remark = f"{self._table} has {of}: the first {len(rows)} are taken"
        frames = [TimedFrame(number, at_ns) for number, (at_ns, put_in) in enumerate(rows) if not put_in]
        if len(frames) < len(rows):
            fillers = f"{len(rows) - len(frames)} of {len(rows)} frames are fillers"
            self.remark = f"{self._table}: {fillers} and left out"
        check_order(str(self._table), frames)
        return frames


def is_phone(folder: Path) -> bool:
    """Whether a folder holds one phone's shots of libsoftwaresync, or its videos of RecSync."""
    return folder.is_dir() and (next(_metadata_in(folder), None) is not None or bool(_pairs_in(folder)))


def phone(name: str, folder: Path, *, png: bool, recording: str | None = None) -> Source:
    """The source of a phone's folder. Raises BadInputError where `recording` does not tell one of several."""
    pairs = _pairs_in(folder)
    if not pairs:
        return _shots_of(name, folder)
    chosen = [path for path in pairs if recording is None or recording in path.stem]
    if len(chosen) == 1:
        return PhoneVideo(name, chosen[0], png=png)
    several = "several recordings"
    hint = f"--recording {pairs[0].stem}, or choose one: {name}={pairs[0]}"
    if recording is not None:
        several = f"{len(chosen)} recordings named like {recording}"
        hint = "--recording takes a part of one's name that no other has"
    raise BadInputError(f"{folder} has {several}: {', '.join(path.name for path in pairs)}", hint=hint)


def table_of(video: Path) -> Path | None:
    """RecSync's table of a video's times, beside it or beside the folder VID that it is in."""
    folders = (video.parent, video.parent.parent) if video.parent.name == _VIDEOS else (video.parent,)
    for folder in folders:
        for stem in (video.stem, video.stem.removeprefix("VID_")):
            table = folder / f"{stem}.csv"
            # It begins with a time in ns, or with RecSyncNG's heading, or has nothing in it.
            if table.is_file() and re.match(rf"(-?\d{{1,19}}\s*|{_HEADING}.*|)$", _first_line(table)):
                return table
    return None


def _first_line(table: Path) -> str:
    with table.open("rb") as file:
        lines = file.read(4096).decode("utf-8", "replace").splitlines()
    return next((line for line in lines if line.strip() and not line.startswith("#")), "")


def _metadata_in(folder: Path) -> Iterator[Path]:
    """The metadata of all shots, in the folder or in one folder a shot."""
    yield from sorted(folder.glob(f"{_METADATA}*.txt"))
    yield from sorted(folder.glob(f"*/{_METADATA}*.txt"))


def _pairs_in(folder: Path) -> list[Path]:
    """The videos with a table of one phone; those of RecSyncNG's postprocessing are a camera each."""
    places = (folder, folder / _VIDEOS, folder / "RecSync" / _VIDEOS, folder / "TMP_MROB" / _VIDEOS)
    videos = [path for place in places for path in sorted(place.glob("*.mp4"))]
    tables = {path: table for path in videos if (table := table_of(path)) is not None}
    return [path for path, table in tables.items() if not _first_line(table).startswith(_HEADING)]


def _shot(metadata: Path) -> _Shot | None:
    times = _values(metadata)
    if _LEADER not in times:
        raise BadInputError(f"{metadata} has no {_LEADER}")
    time = metadata.stem.removeprefix(_METADATA)
    for image in (metadata.with_name(f"img_{time}{suffix}") for suffix in (".jpg", ".nv21")):
        if image.is_file():
            return image, times[_LEADER], times.get(_LOCAL)
    return None


def _values(path: Path) -> dict[str, int]:
    """Numbers of `name: number` lines."""
    found = re.findall(r"^(\w+):\s*(-?\d+)\s*$", read_text(path), re.MULTILINE)
    return {key: int(value) for key, value in found}


def _from_nv21(file: Path) -> bytes:
    """Raw NV21 (a plane of brightness, then interleaved V and U at half the size) as JPEG."""
    import cv2
    import numpy as np

    time = file.stem.removeprefix("img_")
    size = _values(file.with_name(f"nv21_metadata_{time}.txt"))
    width, height = size.get("width", 0), size.get("height", 0)
    raw = np.frombuffer(file.read_bytes(), np.uint8)
    if width <= 0 or height <= 0 or width % 2 or height % 2 or raw.size != width * height * 3 // 2:
        raise BadInputError(f"{file} is not {width}x{height} pixels of NV21, as its metadata says")
    return encode_image(cv2.cvtColor(raw.reshape(height * 3 // 2, width), cv2.COLOR_YUV2BGR_NV21))


def _rows(table: Path) -> list[tuple[int, bool]]:
    """The time in ns of every frame, and whether it was put in where the phone dropped one."""
    rows: list[tuple[int, bool]] = []
    for number, line in enumerate(read_text(table).splitlines(), 1):
        text, _, made = (part.strip() for part in line.partition(","))
        if not text or text.startswith("#") or (number == 1 and text == _HEADING):
            continue
        if not re.fullmatch(r"-?\d{1,19}", text):
            raise BadInputError(f"{table}, line {number}: {text!r} is not a time in ns")
        rows.append((int(text), made == "Generated"))
    if not rows:
        raise BadInputError(f"{table} has no times")
    return rows


def open_sources(paths: Sequence[str], *, png: bool = False, recording: str | None = None) -> list[Source]:
    """The cameras of `NAME=PATH` arguments, or of one folder whose subfolders or videos are cameras.

    `recording` is part of the name of one of several recordings of RecSync on each phone.
    Raises BadInputError for what is missing, empty, doubled or badly named.
    """
    sources: list[Source] = []
    for text in paths:
        name, path = split_name(text)
        if not path.exists():
            raise BadInputError(f"nothing at {path}")
        if not name and path.is_dir() and not is_phone(path):
            sources += _sources_in(path, png, recording)
        else:
            own = path.resolve().name if path.is_dir() else path.stem
            sources.append(_source(name or own, path, png, recording))
    names = [source.name for source in sources]
    for name in names:
        if names.count(name) > 1:
            raise BadInputError(f"two cameras are named {name}", hint="name them: NAME=PATH")
    if not sources:
        raise BadInputError("nothing to import", hint="give a folder, or NAME=PATH for each camera")
    return sorted(sources, key=lambda source: natural_order(source.name))


def split_name(text: str) -> tuple[str, Path]:
    """Split `NAME=PATH`; the name is empty where there is none."""
    name, separator, path = text.partition("=")
    if separator and is_name(name) and not Path(text).exists():
        return name, Path(path)
    return "", Path(text)


def _source(name: str, path: Path, png: bool, recording: str | None) -> Source:
    check_name(name, "camera")
    if is_phone(path):
        return phone(name, path, png=png, recording=recording)
    if path.is_dir() or path.suffix.lower() in IMAGE_SUFFIXES:
        return image_folder(name, path)
    return PhoneVideo(name, path, png=png) if table_of(path) else Video(name, path, png=png)


def _sources_in(folder: Path, png: bool, recording: str | None) -> list[Source]:
    videos = videos_in(folder)
    folders = [path for path in folder.iterdir() if path.is_dir() and (images_in(path) or is_phone(path))]
    if not videos and not folders:
        hint = "it needs a subfolder of images or a video file for each camera"
        if images_in(folder):
            hint = f"its images are of one camera: cam0={folder}"
        raise BadInputError(f"no cameras in {folder}", hint=hint)
    if videos and folders:
        raise BadInputError(f"{folder} has both videos and folders of images", hint="name them: NAME=PATH")
    named = [(path.stem, path) for path in videos] + [(path.name, path) for path in folders]
    return [_source(name, path, png, recording) for name, path in named]
