"""The record in an export, `simulshot.json`: all that the other program's format has no place for.

With `frames.csv`, which says where each image is in the export, an export becomes the session again that it
was made of.
"""

from pathlib import Path

import msgspec

from capture_app.session.format.calibration import Calibration
from capture_app.session.format.checks import check_references, encode_checked, indented, read_struct
from capture_app.session.format.manifest import ImageRecord, Manifest, image_path

RECORD = "simulshot.json"
FRAMES = "frames.csv"
"""In every export: where each image is in the export, with its time in ns of the leader's clock."""


class ExportRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The format of an export, and the session's manifest and calibration as they were.

    Cameras whose pictures were redrawn have the calibration of the new ones.
    """

    format: str
    manifest: Manifest
    calibration: Calibration | None = None
    schema_version: int = 1


def write_record(folder: Path, record: ExportRecord) -> None:
    """Write the record into an export's folder; frames of videos are images in it."""
    whole = msgspec.structs.replace(record, manifest=with_images_listed(record.manifest))
    (folder / RECORD).write_bytes(indented(encode_checked(whole, ExportRecord)))


def with_images_listed(manifest: Manifest) -> Manifest:
    """The manifest of a session in which the frames of its videos are images."""
    images = tuple(_as_image(image) for image in manifest.images)
    return msgspec.structs.replace(manifest, images=images, videos=())


def read_record(folder: Path) -> ExportRecord:
    """Read the record of an export. Raises BadInputError where it is broken or contradicts itself."""
    record = read_struct(folder / RECORD, ExportRecord, 1)
    check_references(folder / RECORD, record.manifest)
    return record


def _as_image(record: ImageRecord) -> ImageRecord:
    if type(record) is ImageRecord:
        return record
    values = {name: getattr(record, name) for name in ImageRecord.__struct_fields__}
    return ImageRecord(**{**values, "path": image_path(record.camera, record.instant)})
