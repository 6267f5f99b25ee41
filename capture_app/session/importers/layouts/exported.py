"""Our own exports: the session again that they were made of, by `frames.csv` and `simulshot.json`."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from capture_app.errors import BadInputError
from capture_app.session.exchange.export_record import FRAMES, ExportRecord, read_record
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.checks import inside
from capture_app.session.format.manifest import ImageRecord, Manifest
from capture_app.session.importers.frame_matching import Instant, TimedFrame, Timeline
from capture_app.session.importers.layouts.layout import Layout
from capture_app.session.importers.sources import VIDEO_SUFFIXES, Source, Video
from capture_app.session.reading.decoding import image_size

Place = tuple[str, int]
"""A camera and an instant of the session that was exported."""

_UNREADABLE = ("rrd",)
_OF_THE_FRAME = (
    "uncertainty_ns", "hard_bound_ns", "exposure_start_ns", "exposure_ns", "gain", "white_balance",
    "sequence", "outlier_ns", "alignment_offset_ns", "substitute", "late",
)  # fmt: skip
_LEFT_OUT = "the export does not have it"


class ExportedImages(Source):
    """A camera's image files in an export, byte for byte."""

    kind = "exported images"
    numbered = True

    def __init__(self, name: str, path: Path, files: Sequence[Path]) -> None:
        self.name, self.path, self._files = name, path, files
        self.numbers = range(len(files))
        self.suffix = files[0].suffix.lower()

    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        """See `Source.frames`."""
        for index in sorted(indices):
            file = self._files[index]
            try:
                data = file.read_bytes()
            except OSError as error:
                raise BadInputError(f"cannot read {file}: {error.strerror}") from error
            size = image_size(data)
            if size is None:
                raise BadInputError(f"{file} is not an image that can be decoded")
            yield index, data, size


class ExportedVideo(Source):
    """A camera's video in an export: some of its frames, each by its number."""

    kind = "exported video"
    numbered = True

    def __init__(self, name: str, path: Path, frames: Sequence[int], *, png: bool) -> None:
        self.name, self.path, self._frames = name, path, frames
        self.numbers = range(len(frames))
        self._video = Video(name, path, png=png)
        self._video.use_embedded_times()
        self.suffix = self._video.suffix

    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        """See `Source.frames`."""
        wanted = {self._frames[index]: index for index in indices}
        for frame, data, size in self._video.frames(sorted(wanted)):
            yield wanted[frame], data, size


def exported(folder: Path, *, png: bool) -> Layout:
    """An export's folder. Raises BadInputError where what it says of itself is broken."""
    record = read_record(folder)
    if record.format in _UNREADABLE:
        raise BadInputError(f"{folder} is an export for {record.format}, which cannot be read back")
    if record.format == "mcap":
        from capture_app.session.importers.layouts.mcap import mcap

        files = sorted(folder.glob("*.mcap"))
        if len(files) != 1:
            raise BadInputError(f"{folder} does not have one .mcap but {len(files)}")
        return mcap(files[0])
    rows = _rows(folder)
    sources, places = [], {}
    for camera in record.manifest.cameras:
        own = {at: row for at, row in rows.items() if at[0] == camera.name and row[0].is_file()}
        if own:
            sources.append(_source(camera.name, list(own.values()), png))
            places.update({at: index for index, at in enumerate(own)})
    if not sources:
        raise BadInputError(f"{folder} has none of the files that its {FRAMES} names")
    return layout_of_record(folder, record, sources, places)


def layout_of_record(
    path: Path, record: ExportRecord, sources: Sequence[Source], places: Mapping[Place, int]
) -> Layout:
    """The layout of what was exported; `places` says which frame of its source is of which place."""
    order = [camera.name for camera in record.manifest.cameras]
    sources = sorted((one for one in sources if one.name in order), key=lambda one: order.index(one.name))
    return Layout(
        program=f"simulshot: the session {record.manifest.name}, exported for {record.format}",
        path=path,
        sources=tuple(sources),
        timeline=_timeline(record.manifest, places, {source.name for source in sources}),
        record=record,
    )


def calibration_of_record(record: ExportRecord, sizes: Mapping[str, tuple[int, int]]) -> Calibration | None:
    """The calibration that was exported. Raises BadInputError where the images are of another size now."""
    for name, camera in record.calibration.cameras.items() if record.calibration else ():
        if sizes.get(name, (camera.width, camera.height)) != (camera.width, camera.height):
            was, now = f"{camera.width}x{camera.height}", "x".join(map(str, sizes[name]))
            raise BadInputError(
                f"{name} was exported with {was} pixels and has {now} now",
                hint="--calibration takes one that fits",
            )
    return record.calibration


def _rows(folder: Path) -> dict[Place, tuple[Path, int]]:
    """The file, and the number of its frame, of every place that the export has."""
    path, found = folder / FRAMES, {}
    try:
        with path.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                if row["file"] and row["content"] in ("image", "substitute"):
                    at = row["camera"], int(row["instant"])
                    found[at] = inside(folder, row["file"]), int(row["frame"])
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadInputError(f"cannot read {path}: {error}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise BadInputError(f"{path} is not the table of an export: {error}") from error
    return found


def _source(name: str, rows: Sequence[tuple[Path, int]], png: bool) -> Source:
    first = rows[0][0]
    if first.suffix.lower() in VIDEO_SUFFIXES:
        return ExportedVideo(name, first, [frame for _, frame in rows], png=png)
    return ExportedImages(name, first.parent, [file for file, _ in rows])


def _timeline(manifest: Manifest, places: Mapping[Place, int], cameras: set[str]) -> Timeline:
    recorded = {(image.camera, image.instant): image for image in manifest.images}
    # A frame that stands for two instants is in an export once.
    by_content = {(at[0], recorded[at].sha256): index for at, index in places.items() if at in recorded}
    why = {(gone.camera, gone.instant): gone.reason for gone in manifest.missing}
    instants = []
    for number, at_ns in enumerate(manifest.burst.instants_ns):
        here = {name: recorded[name, number] for name in cameras if (name, number) in recorded}
        frames = {
            name: _timed(index, image)
            for name, image in here.items()
            if (index := places.get((name, number), by_content.get((name, image.sha256)))) is not None
        }
        if here and not frames:  # an export of some of the instants
            continue
        gone = {name: why.get((name, number), _LEFT_OUT) for name in cameras if name not in frames}
        instants.append(Instant(at_ns, frames, gone))
    periods = {camera.name: camera.facts.period_ns for camera in manifest.cameras if camera.name in cameras}
    return Timeline(instants, manifest.burst.period_ns, periods)


def _timed(index: int, image: ImageRecord) -> TimedFrame:
    further: dict[str, Any] = {key: getattr(image, key) for key in _OF_THE_FRAME}
    return TimedFrame(index, image.leader_ns, image.local_ns, further)
