"""Tracks of a video: its container, opened for those who read sound, dates or metadata."""

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from capture_app.common.errors import BadInputError


@contextmanager
def open_container(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a video; yield the package PyAV and the container. Raises BadInputError with a short reason."""
    try:
        av: Any = importlib.import_module("av")
    except ImportError:
        raise BadInputError("PyAV is not installed") from None
    if not path.is_file():
        raise BadInputError("it is not a file")
    try:
        with av.open(str(path), metadata_errors="replace") as container:
            yield av, container
    except (av.FFmpegError, OSError, ValueError):
        raise BadInputError("it cannot be decoded") from None
