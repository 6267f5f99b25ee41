"""Our own exports are the session again that they were made of; of other messages, each topic is a camera.

An export has `frames.csv` and `simulshot.json`, an MCAP of ours the session's manifest and calibration
attached.
"""

import csv
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from capture_app.common.errors import BadInputError
from capture_app.session.exchange import FRAMES, ExportRecord, read_record
from capture_app.session.files.strangers import decode_struct, read_text
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import (
    CALIBRATION,
    MANIFEST,
    SCHEMA_VERSION,
    ImageRecord,
    Manifest,
    check_references,
    inside,
)
from capture_app.session.importers.bags import attachments, read_bag
from capture_app.session.importers.frame_matching import Instant, TimedFrame, Timeline, timeline_by_times
from capture_app.session.importers.sources import VIDEO_SUFFIXES, Images, Layout, Source, Video

Place = tuple[str, int]
"""A camera and an instant of the session that was exported."""

_UNREADABLE = ("rrd",)
_OF_THE_FRAME = (
    "uncertainty_ns", "hard_bound_ns", "exposure_start_ns", "exposure_ns", "gain", "white_balance",
    "sequence", "outlier_ns", "alignment_offset_ns", "substitute", "late",
)  # fmt: skip
_LEFT_OUT = "the export does not have it"


def exported(folder: Path, *, png: bool) -> Layout:
    """An export's folder. Raises BadInputError where what it says of itself is broken."""
    record = read_record(folder)
    if record.format in _UNREADABLE:
        raise BadInputError(f"{folder} is an export for {record.format}, which cannot be read back")
    if record.format == "mcap":
        found = [*folder.glob("*.mcap"), *(path.parent for path in folder.glob("*/metadata.yaml"))]
        if len(found) != 1:
            raise BadInputError(f"{folder} does not have one .mcap but {len(found)}")
        return layout_of_record(folder, record, read_bag(found[0]).sources, _in_order(_rows(folder)))
    rows = _rows(folder)
    sources: list[Source] = []
    places: dict[Place, int] = {}
    for camera in record.manifest.cameras:
        own = {at: row for at, row in rows.items() if at[0] == camera.name and row[0].is_file()}
        if not own:
            continue
        files = [file for file, _ in own.values()]
        if files[0].suffix.lower() in VIDEO_SUFFIXES:
            video = Video(camera.name, files[0], png=png)
            video.use_embedded_times()
            sources.append(video)
            places.update({at: number for at, (_, number) in own.items()})
        else:
            sources.append(Images(camera.name, files[0].parent, files, "exported images"))
            places.update({at: index for index, at in enumerate(own)})
    if not sources:
        raise BadInputError(f"{folder} has none of the files that its {FRAMES} names")
    return layout_of_record(folder, record, sources, places)


def _in_order(rows: Mapping[Place, tuple[Path, int]]) -> dict[Place, int]:
    """Which frame of its camera each place is, where the frames of all are numbered together."""
    seen: Counter[str] = Counter()
    places = {}
    for at in sorted(rows, key=lambda at: rows[at][1]):
        places[at] = seen[at[0]]
        seen[at[0]] += 1
    return places


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
    path = folder / FRAMES
    try:
        return {
            (row["camera"], int(row["instant"])): (inside(folder, row["file"]), int(row["frame"]))
            for row in csv.DictReader(read_text(path).splitlines())
            if row["file"] and row["content"] in ("image", "substitute")
        }
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise BadInputError(f"{path} is not the table of an export: {error}") from error


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


def of_messages(path: Path) -> Layout:
    """The cameras of a recording of messages, by its own stamps or by the record that an MCAP of ours has."""
    bag, attached = read_bag(path), attachments(path)
    if MANIFEST in attached:
        return layout_of_record(path, _record(path, attached), bag.sources, bag.places)
    return Layout(
        program=bag.sources[0].kind,
        path=path,
        sources=tuple(bag.sources),
        timeline=timeline_by_times(str(path), bag.times),
        views=bag.views,
    )


def _record(path: Path, attached: Mapping[str, bytes]) -> ExportRecord:
    manifest = decode_struct(path / MANIFEST, attached[MANIFEST], Manifest, SCHEMA_VERSION)
    check_references(path / MANIFEST, manifest)
    data = attached.get(CALIBRATION)
    calibration = None if data is None else decode_struct(path / CALIBRATION, data, Calibration, 1)
    return ExportRecord(format="mcap", manifest=manifest, calibration=calibration)
