"""File of the marks that fell into no take, in a rig's sessions folder."""

from contextlib import closing
from pathlib import Path

import msgspec

from capture_app.session.files.disk import disk_errors
from capture_app.session.files.durable import AppendOnlyFile
from capture_app.session.format.marks import Mark


def append_mark(file: Path, mark: Mark) -> None:
    """Append a mark to a file, made if it is missing. Raises DiskError."""
    with disk_errors(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        with closing(AppendOnlyFile(file)) as lines:
            lines.append(msgspec.json.encode(mark.as_event()), durable=True)
