"""ROS bags, and .mcap files of ROS or Foxglove messages: each topic of images is a camera.

Our own .mcap, alone or in the folder of an export, is read as its original session: its manifest and
calibration are attachments, or in the folder.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from itertools import count
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.plugins.programs.mcap.bags import MCAP, attachments, is_bag, read_bag
from capture_app.session.files.untrusted_files import decode_struct
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.export_record import RECORD, ExportRecord, read_record
from capture_app.session.format.manifest import (
    CALIBRATION,
    MANIFEST,
    SCHEMA_VERSION,
    Manifest,
    check_references,
)
from capture_app.session.importing.exported_session import Place, exported_files, exported_layout
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.recording_sources import Layout


def open_recording(path: Path, *, png: bool, recording: str | None) -> Layout | None:
    """Open the cameras of a recording of messages, timed by its own stamps, or one of our exports.

    Raises BadInputError if an export's records are malformed.
    """
    if (path / RECORD).is_file():
        return _open_export(path)
    if path.suffix.lower() == MCAP and path.is_file():
        attached = attachments(path)
        if MANIFEST in attached:
            bag, places = read_bag(path)
            return exported_layout(path, _record(path, attached), bag.sources, places)
    return read_bag(path)[0] if is_bag(path) else None


def _open_export(folder: Path) -> Layout | None:
    record, rows = read_record(folder), exported_files(folder)
    if MCAP not in {file.suffix.lower() for file, _ in rows.values()}:
        return None
    paths = [*folder.glob("*.mcap"), *(path.parent for path in folder.glob("*/metadata.yaml"))]
    if len(paths) != 1:
        raise BadInputError(
            f"{folder} does not have one .mcap but {len(paths)}", hint="keep the exported one only"
        )
    return exported_layout(folder, record, read_bag(paths[0])[0].sources, _in_order(rows))


def _in_order(rows: Mapping[Place, tuple[Path, int]]) -> dict[Place, int]:
    """Return the frame index of each (camera, instant) within its camera, from numbers across all cameras."""
    numbers: defaultdict[str, Iterator[int]] = defaultdict(count)
    return {at: next(numbers[at[0]]) for at in sorted(rows, key=lambda at: rows[at][1])}


def _record(path: Path, attached: Mapping[str, bytes]) -> ExportRecord:
    manifest = decode_struct(path / MANIFEST, attached[MANIFEST], Manifest, SCHEMA_VERSION)
    check_references(path / MANIFEST, manifest)
    data = attached.get(CALIBRATION)
    calibration = None if data is None else decode_struct(path / CALIBRATION, data, Calibration, 1)
    return ExportRecord(format="mcap", manifest=manifest, calibration=calibration)


IMPORTER = Importer(
    program="ROS, Foxglove",
    help="a rosbag2 folder, a ROS 1 .bag, an .mcap of ROS's or Foxglove's messages",
    open_recording=open_recording,
    priority=2,
)
