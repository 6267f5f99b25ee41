"""Files that may be anybody's: regular ones of bounded size, as a pipe keeps a reader waiting for ever."""

import errno
import io
import os
import stat
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

from capture_app.errors import BadInputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def read_regular(path: Path) -> bytes:
    """Return the bytes of a regular file, at a link's end too. Raises OSError for anything else."""
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(handle, "rb") as file:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file", str(path))
        return file.read()


def read_text(path: Path, *, encoding: str = "utf-8") -> str:
    """The text of a file. Raises BadInputError where it cannot be read or is none."""
    try:
        return read_regular(path).decode(encoding)
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise BadInputError(f"cannot read {path}: {error}") from error


MOST_BYTES = 1 << 30
"""The most that all arrays of a file may have, unpacked."""


def read_arrays(path: Path) -> "dict[str, NDArray[np.generic]]":
    """The arrays of a .npz file, by name. Raises BadInputError for a file that cannot be read as one."""
    import numpy as np  # slow to import, and this module is in every command's way

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
