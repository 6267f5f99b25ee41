"""Opens OpenCV's YAML and XML files (cv2.FileStorage), with its errors as ours."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from capture_app.errors import BadInputError


@contextmanager
def open_storage(path: Path) -> Iterator[Any]:
    """A cv2.FileStorage of a file, for reading. Raises BadInputError for what it cannot read."""
    import cv2

    before = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        yield storage
        storage.release()
    except (cv2.error, SystemError, TypeError, ValueError) as error:
        reason = str(error).strip().splitlines()[-1] if str(error).strip() else "not OpenCV's format"
        raise BadInputError(f"cannot read the calibration {path}: {reason}") from error
    finally:
        cv2.utils.logging.setLogLevel(before)
