"""Exports of sessions read back as their sessions: the table of frames, and times from the manifest."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

from capture_app.session.files.untrusted_files import read_text, rejecting
from capture_app.session.format.export_record import FRAMES, ExportRecord
from capture_app.session.format.manifest import Manifest, inside
from capture_app.session.importing.frame_matching import Instant, TimedFrame, Timeline
from capture_app.session.importing.recording_sources import Layout, Source

Place = tuple[str, int]
"""Camera and instant in the exported session."""

_OF_THE_FRAME = (
    "uncertainty_ns", "hard_bound_ns", "exposure_start_ns", "exposure_ns", "gain", "white_balance",
    "sequence", "outlier_ns", "alignment_offset_ns", "substitute", "late",
)  # fmt: skip


def exported_layout(
    path: Path, record: ExportRecord, sources: Sequence[Source], places: Mapping[Place, int]
) -> Layout:
    """Describe an export as a recording to import: its sources, in the manifest's order, and its times.

    `places` maps each (camera, instant) to the index of its frame in that camera's source.
    """
    order = [camera.name for camera in record.manifest.cameras]
    sources = sorted(
        (source for source in sources if source.name in order), key=lambda source: order.index(source.name)
    )
    return Layout(
        program=f"simulshot: the session {record.manifest.name}, exported for {record.format}",
        path=path,
        sources=tuple(sources),
        timeline=_timeline(record.manifest, places, {source.name for source in sources}),
        record=record,
    )


def exported_files(folder: Path) -> dict[Place, tuple[Path, int]]:
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
