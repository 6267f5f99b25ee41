"""simulshot's own files: an export is read as its original session, and a session as a calibration.

An export has `frames.csv` and `simulshot.json`; in our MCAP files the session's manifest and calibration are
attachments.
"""

import csv
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.plugins.programs.mcap.bags import MCAP, attachments, read_bag
from capture_app.session.files.untrusted_files import decode_struct, read_struct, read_text, rejecting
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.export_record import FRAMES, RECORD, ExportRecord, read_record
from capture_app.session.format.manifest import (
    CALIBRATION,
    IMAGE_SUFFIXES,
    MANIFEST,
    SCHEMA_VERSION,
    Manifest,
    check_references,
    inside,
)
from capture_app.session.importing.frame_matching import Instant, TimedFrame, Timeline
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.recording_sources import VIDEO_SUFFIXES, Images, Layout, Source, Video
from capture_app.session.importing.views import View, Views, pinhole, read_json

Place = tuple[str, int]
"""Camera and instant in the exported session."""

_OF_THE_FRAME = (
    "uncertainty_ns", "hard_bound_ns", "exposure_start_ns", "exposure_ns", "gain", "white_balance",
    "sequence", "outlier_ns", "alignment_offset_ns", "substitute", "late",
)  # fmt: skip


def open_recording(path: Path, *, png: bool, recording: str | None) -> Layout | None:
    """Open an export, folder or MCAP. Raises BadInputError if its records are malformed."""
    if path.suffix.lower() == MCAP and path.is_file():
        attached = attachments(path)
        if MANIFEST not in attached:
            return None
        bag, places = read_bag(path)
        return _layout(path, _record(path, attached), bag.sources, places)
    return _open_export(path, png) if (path / RECORD).is_file() else None


def _open_export(folder: Path, png: bool) -> Layout:
    record, rows = read_record(folder), _rows(folder)
    endings = {file.suffix.lower() for file, _ in rows.values()}
    if MCAP in endings:
        found = [*folder.glob("*.mcap"), *(path.parent for path in folder.glob("*/metadata.yaml"))]
        if len(found) != 1:
            raise BadInputError(
                f"{folder} does not have one .mcap but {len(found)}", hint="keep the exported one only"
            )
        return _layout(folder, record, read_bag(found[0])[0].sources, _in_order(rows))
    if not endings <= {*IMAGE_SUFFIXES, *VIDEO_SUFFIXES}:
        raise BadInputError(
            f"{folder} is an export for {record.format}, which cannot be read back",
            hint="import an export to mcap, mp4 or colmap, or copy the session itself",
        )
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
            places |= {at: number for at, (_, number) in own.items()}
        else:
            sources.append(Images(camera.name, files[0].parent, files, "exported images"))
            places |= {at: index for index, at in enumerate(own)}
    if not sources:
        raise BadInputError(
            f"{folder} has none of the files that its {FRAMES} names",
            hint="copy the whole export, or export the session again",
        )
    return _layout(folder, record, sources, places)


def _in_order(rows: Mapping[Place, tuple[Path, int]]) -> dict[Place, int]:
    """Return the frame index of each (camera, instant) within its camera, from numbers across all cameras."""
    numbers: defaultdict[str, Iterator[int]] = defaultdict(count)
    return {at: next(numbers[at[0]]) for at in sorted(rows, key=lambda at: rows[at][1])}


def _layout(
    path: Path, record: ExportRecord, sources: Sequence[Source], places: Mapping[Place, int]
) -> Layout:
    """Describe an export as a recording to import: its sources, in the manifest's order, and its times.

    `places` maps each (camera, instant) to the index of its frame in that camera's source.
    """
    order = [camera.name for camera in record.manifest.cameras]
    sources = sorted((one for one in sources if one.name in order), key=lambda one: order.index(one.name))
    return Layout(
        program=f"simulshot: the session {record.manifest.name}, exported for {record.format}",
        path=path,
        sources=tuple(sources),
        timeline=_timeline(record.manifest, places, {source.name for source in sources}),
        record=record,
    )


def _rows(folder: Path) -> dict[Place, tuple[Path, int]]:
    """Return the file, and the frame number in it, of every (camera, instant) in the export."""
    path = folder / FRAMES
    with rejecting(
        f"{path} is not the table of an export",
        *(KeyError, TypeError, ValueError, csv.Error),
        hint="copy the whole export, or export the session again",
    ):
        return {
            (row["camera"], int(row["instant"])): (inside(folder, row["file"]), int(row["frame"]))
            for row in csv.DictReader(read_text(path).splitlines())
            if row["file"] and row["content"] in ("image", "substitute")
        }


def _timeline(manifest: Manifest, places: Mapping[Place, int], cameras: set[str]) -> Timeline:
    recorded = {(image.camera, image.instant): image for image in manifest.images}
    # A frame that serves two instants is in an export once.
    by_content = {(at[0], recorded[at].sha256): index for at, index in places.items() if at in recorded}
    why = {(absent.camera, absent.instant): absent.reason for absent in manifest.missing}
    instants = []
    for number, at_ns in enumerate(manifest.burst.instants_ns):
        here = {name: recorded[name, number] for name in cameras if (name, number) in recorded}
        frames = {
            name: TimedFrame(
                index, image.leader_ns, image.local_ns, {key: getattr(image, key) for key in _OF_THE_FRAME}
            )
            for name, image in here.items()
            if (index := places.get((name, number), by_content.get((name, image.sha256)))) is not None
        }
        if here and not frames:  # an export of some of the instants
            continue
        absent = {
            name: why.get((name, number), "the export does not have it")
            for name in cameras
            if name not in frames
        }
        instants.append(Instant(at_ns, frames, absent))
    periods = {camera.name: camera.facts.period_ns for camera in manifest.cameras if camera.name in cameras}
    return Timeline(instants, manifest.burst.period_ns, periods)


def _record(path: Path, attached: Mapping[str, bytes]) -> ExportRecord:
    manifest = decode_struct(path / MANIFEST, attached[MANIFEST], Manifest, SCHEMA_VERSION)
    check_references(path / MANIFEST, manifest)
    data = attached.get(CALIBRATION)
    calibration = None if data is None else decode_struct(path / CALIBRATION, data, Calibration, 1)
    return ExportRecord(format="mcap", manifest=manifest, calibration=calibration)


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read a calibration.json, or a session folder's. Raises BadInputError if it is malformed."""
    path = paths[0][1]
    path = path / CALIBRATION if (path / CALIBRATION).is_file() else path
    content = read_json(path)
    if not isinstance(content, dict) or not isinstance(content.get("cameras"), dict) or "frames" in content:
        return None
    own = read_struct(path, Calibration, 1)
    views = {
        name: View(
            matrix=pinhole(of.fx, of.fy, of.cx, of.cy),
            distortion=np.array(of.distortion, np.float64),
            rotation=np.array(of.rotation, np.float64),
            translation=np.array(of.translation, np.float64),
            size=(of.width, of.height),
        )
        for name, of in own.cameras.items()
    }
    return Views(views, own.source or path.name, own.unit)


IMPORTER = Importer(
    program="simulshot",
    help="an export, which becomes its session again; calibration.json, or its session, as a calibration",
    open_recording=open_recording,
    read_calibration=read_calibration,
    calibration_files=(CALIBRATION,),
    priority=1,
)
