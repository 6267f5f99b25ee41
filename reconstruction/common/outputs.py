"""Outputs of a command in its folder: metrics, and results in Python."""

from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import msgspec
import numpy as np

from capture_app.common.text import pretty_json
from capture_app.session.files.durable import write_atomic
from capture_app.session.files.output_folder import OutputFolder, replaces_only
from capture_app.session.reading.decoding import decode_image
from reconstruction.common.geometry import Array

METRICS, REPORT = "metrics.json", "report.html"
OURS = {METRICS, REPORT, "pictures", "depth.tiff", "depth_filled.tiff", "depth_checked.tiff"}
OURS |= {"difference.tiff", "registration.json"}


def comparison_folder(out: Path) -> OutputFolder:
    """Return a folder that replaces an earlier comparison at `out`, and nothing else.

    Raises:
        BadInputError: there is something else at `out`.
    """
    return OutputFolder(out, replaces_only(OURS))


def write_metrics(folder: Path, result: msgspec.Struct) -> None:
    """Write the metrics into a comparison's folder."""
    write_atomic(folder / METRICS, pretty_json(result))


Result = TypeVar("Result")


@dataclass(frozen=True)
class Made(Generic[Result]):
    """Result of a command in Python: `result` as --json prints it, and its files in `folder`.

    A folder that the caller did not name is temporary. It is deleted with this object.
    """

    result: Result
    folder: Path

    def image(self, file: str) -> Array:
        """Return an image file as an array; colours are BGR. Raises OSError if the file does not exist."""
        return np.asarray(decode_image(self.folder.joinpath(file).read_bytes()))
