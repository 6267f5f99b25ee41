"""Opens videos for what they hold beside their pictures."""

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

Found = TypeVar("Found")


def read_container(path: Path, read: Callable[[Any, Any], Found]) -> Found | None:
    """What `read` finds with PyAV in the opened video; None where PyAV is not installed, or FFmpeg fails."""
    try:
        av: Any = importlib.import_module("av")
    except ImportError:
        return None
    try:
        with av.open(str(path)) as container:
            return read(av, container)
    except av.FFmpegError:
        return None
