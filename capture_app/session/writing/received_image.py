"""An image that has come into a file of its own, and waits for its place in a session."""

from dataclasses import dataclass
from pathlib import Path

from capture_app.errors import BadInputError
from capture_app.names import check_name
from capture_app.session.format.checks import encode_checked
from capture_app.session.format.manifest import IMAGE_SUFFIXES, ImageRecord, image_path


@dataclass(frozen=True, slots=True)
class ReceivedImage:
    """Its file is on the session's disk and fits the record."""

    record: ImageRecord
    file: Path
    truth: bytes = b""
    """The .npz of a simulated image; empty for none."""
    true_ns: int | None = None
    """True start of the first row's exposure, of a simulated image."""

    def journal_line(self) -> bytes:
        """The record as the journal has it. Raises BadInputError for one that no session can hold."""
        record = self.record
        check_name(record.camera, "camera")
        suffix = Path(record.path).suffix
        if suffix not in IMAGE_SUFFIXES or record.path != image_path(record.camera, record.instant, suffix):
            raise BadInputError(f"{record.path!r} is not a valid path for an image of {record.camera}")
        return encode_checked(record, ImageRecord)
