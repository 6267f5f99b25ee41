"""RecSync and RecSyncNG: a video of each phone, with frames timed by the leader's clock.

RecSync (MobileRoboticsSkoltech/RecSync-android, MainActivity.java and CSVLogger.java) writes on each phone
RecSync/VID/VID_TIME.mp4 and RecSync/TIME.csv, which has a line for each frame with its leader time in ns.
RecSyncNG (DFKI-SignLanguage/RecSync-android) writes RecSync/VID/PREFIX_TIME.mp4 and RecSync/PREFIX_TIME.csv.
Its file_server.py collects both in PREFIX/CLIENT/. Its PostProcessVideos.py converts them to CLIENT.mp4 and
CLIENT.csv, whose second column marks black frames inserted where the phone dropped one.
"""

import re
from collections.abc import Sequence
from itertools import product
from pathlib import Path

from capture_app.common.errors import BadInputError, reading
from capture_app.common.names import IMAGE_SUFFIXES
from capture_app.session.files.untrusted_files import open_regular, read_text
from capture_app.session.importing.frame_matching import TimedFrame, check_order
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.recording_sources import Source, Video

_VIDEOS, _HEADING = "VID", "timestamp"


class PhoneVideo(Video):
    """A video of one phone with RecSync; its table has each frame's leader time."""

    kind = "RecSync"

    def __init__(self, name: str, path: Path, *, png: bool = False) -> None:
        super().__init__(name, path, png=png)
        if (table := table_of(path)) is None:
            raise BadInputError(
                f"{path} has no table of times",
                hint="copy the .csv beside the video from the phone, or import with --fps RATE",
            )
        self._table, rows = table, _rows(table)
        self._rows = rows[: len(self.numbers)]
        put_in = sum(filler for _, filler in self._rows)
        notes = {
            f"{table} has {len(rows)} times for {len(self.numbers)} frames: "
            f"the first {len(self._rows)} are taken": len(rows) != len(self.numbers),
            f"{table}: {put_in} of {len(self._rows)} frames are fillers and left out": put_in,
        }
        self.notes = (*self.notes, *(note for note, holds in notes.items() if holds))

    def embedded_times(self) -> Sequence[TimedFrame]:
        """Return each frame's time; if table and video differ in length, only up to the shorter one's end."""
        frames = [
            TimedFrame(number, at_ns) for number, (at_ns, filler) in enumerate(self._rows) if not filler
        ]
        check_order(str(self._table), frames)
        return frames


def is_camera(path: Path) -> bool:
    """Return whether a path is one phone's folder, or a video with its table of times."""
    if path.is_dir():
        return bool(_pairs_in(path))
    return path.suffix.lower() not in IMAGE_SUFFIXES and table_of(path) is not None


def open_camera(name: str, path: Path, *, png: bool, recording: str | None) -> Source:
    """Open a phone's video. Raises BadInputError if there are several and `recording` names none."""
    if not path.is_dir():
        return PhoneVideo(name, path, png=png)
    pairs = _pairs_in(path)
    chosen = [video for video in pairs if recording is None or recording in video.stem]
    if len(chosen) == 1:
        return PhoneVideo(name, chosen[0], png=png)
    names = ", ".join(video.name for video in pairs)
    if recording is not None:
        raise BadInputError(
            f"{path} has {len(chosen)} recordings named like {recording}: {names}",
            hint="--recording takes a part of one's name that no other has",
        )
    raise BadInputError(
        f"{path} has several recordings: {names}",
        hint=f"--recording {pairs[0].stem}, or choose one: {name}={pairs[0]}",
    )


def table_of(video: Path) -> Path | None:
    """Return RecSync's table of a video's times, beside the video or beside its folder VID."""
    folders = (video.parent, video.parent.parent) if video.parent.name == _VIDEOS else (video.parent,)
    for folder, stem in product(folders, (video.stem, video.stem.removeprefix("VID_"))):
        table = folder / f"{stem}.csv"
        # The table begins with a time in ns or with RecSyncNG's heading, or is empty.
        if table.is_file() and re.match(rf"(-?\d{{1,19}}\s*|{_HEADING}.*|)$", _first_line(table)):
            return table
    return None


def _first_line(table: Path) -> str:
    with reading(table), open_regular(table) as file:
        lines = file.read(4096).decode("utf-8", "replace").splitlines()
    return next((line for line in lines if line.strip() and not line.startswith("#")), "")


def _pairs_in(folder: Path) -> list[Path]:
    """Return one phone's videos that have a table; RecSyncNG's postprocessed videos are separate cameras."""
    places = (folder, folder / _VIDEOS, folder / "RecSync" / _VIDEOS, folder / "TMP_MROB" / _VIDEOS)
    videos = [path for place in places for path in sorted(place.glob("*.mp4"))]
    tables = {path: table for path in videos if (table := table_of(path)) is not None}
    return [path for path, table in tables.items() if not _first_line(table).startswith(_HEADING)]


def _rows(table: Path) -> list[tuple[int, bool]]:
    """Return each frame's time in ns, and whether it was inserted for a dropped one."""
    rows: list[tuple[int, bool]] = []
    for number, line in enumerate(read_text(table).splitlines(), 1):
        text, _, made = (part.strip() for part in line.partition(","))
        if not text or text.startswith("#") or (number == 1 and text == _HEADING):
            continue
        if not re.fullmatch(r"-?\d{1,19}", text):
            raise BadInputError(
                f"{table}, line {number}: {text!r} is not a time in ns",
                hint="copy the table from the phone again, or correct the line",
            )
        rows.append((int(text), made == "Generated"))
    if not rows:
        raise BadInputError(
            f"{table} has no times", hint="copy the table from the phone again, or import with --fps RATE"
        )
    return rows


IMPORTER = Importer(
    program="RecSync, RecSyncNG",
    help="a folder a phone: RecSync/VID/*.mp4 with their .csv; --recording takes a part of a name",
    is_camera=is_camera,
    open_camera=open_camera,
)
