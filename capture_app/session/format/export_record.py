"""The record `simulshot.json` of a session in each export, from which the export can be imported again.

The record is all that the other program's format has no place for; `frames.csv` beside it says where each
image is in the export.
"""

from pathlib import Path

import msgspec

from capture_app.session.files.untrusted_files import read_struct
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import ImageRecord, Manifest, check_references, image_path

RECORD = "simulshot.json"
FRAMES = "frames.csv"
"""In every export: where each image is in the export, with its time in ns of the leader's clock."""


class ExportRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The format of an export, and the session's manifest and calibration as they were.

    Frames of videos are images in it. Cameras whose pictures were redrawn have the new ones' calibration.
    """

    format: str
    manifest: Manifest
    calibration: Calibration | None = None
    schema_version: int = 1


def with_images_listed(manifest: Manifest) -> Manifest:
    """Return the manifest with the frames of its videos listed as image files."""
    fields = [name for name in ImageRecord.__struct_fields__ if name != "path"]
    images = tuple(
        one
        if type(one) is ImageRecord
        else ImageRecord(
            path=image_path(one.camera, one.instant), **{name: getattr(one, name) for name in fields}
        )
        for one in manifest.images
    )
    return msgspec.structs.replace(manifest, images=images, videos=())


def read_record(folder: Path) -> ExportRecord:
    """Read the record of an export. Raises BadInputError where it is broken or contradicts itself."""
    record = read_struct(folder / RECORD, ExportRecord, 1)
    check_references(folder / RECORD, record.manifest)
    return record
