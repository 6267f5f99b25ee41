"""`simulshot.json`, the session's record in every export, from which the export can be imported again.

It holds what the other program's format cannot; `frames.csv` beside it lists the place of each image in the
export.
"""

from pathlib import Path

import msgspec

from capture_app.session.files.untrusted_files import read_struct
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import ImageRecord, Manifest, check_references, image_path

RECORD = "simulshot.json"
FRAMES = "frames.csv"
"""Table in every export: the place of each image in the export, and its leader time in ns."""


class ExportRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Record of an export: its format, and the session's manifest and calibration.

    Frames of videos are listed as images. If a camera's images were resampled for another lens, its
    calibration is the resampled images'.
    """

    format: str
    manifest: Manifest
    calibration: Calibration | None = None
    schema_version: int = 1


def with_images_listed(manifest: Manifest) -> Manifest:
    """Return the manifest with the frames of its videos listed as image files."""
    fields = [name for name in ImageRecord.__struct_fields__ if name != "path"]
    images = tuple(
        image
        if type(image) is ImageRecord
        else ImageRecord(
            path=image_path(image.camera, image.instant), **{name: getattr(image, name) for name in fields}
        )
        for image in manifest.images
    )
    return msgspec.structs.replace(manifest, images=images, videos=())


def read_record(folder: Path) -> ExportRecord:
    """Read the record of an export. Raises BadInputError if it is malformed or contradicts itself."""
    record = read_struct(folder / RECORD, ExportRecord, 1)
    check_references(folder / RECORD, record.manifest)
    return record
