"""Reads numpy's .npz files of strangers: arrays of numbers, of no more bytes than there is use for."""

import io
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture_app.errors import BadInputError
from capture_app.session.files.regular import read_regular

MOST_BYTES = 1 << 30
"""Of all arrays of a file together, unpacked."""


def read_arrays(path: Path) -> dict[str, NDArray[np.generic]]:
    """The arrays of a .npz file, by name. Raises BadInputError for a file that cannot be read as one."""
    try:
        data = io.BytesIO(read_regular(path))
        with zipfile.ZipFile(data) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > MOST_BYTES:
            raise ValueError(f"its arrays have {size} bytes, and {MOST_BYTES} at most are read")
        with np.load(data, allow_pickle=False) as file:
            return {name: np.asarray(file[name]) for name in file.files}
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror or error}") from error
    except Exception as error:  # zipfile, its decompressors and numpy raise a dozen kinds
        reason = " ".join(str(error).split()) or type(error).__name__
        raise BadInputError(f"cannot read {path} as arrays (.npz): {reason}") from error
