"""Reader of pickled arrays and numbers that runs nothing of the file.

A pickle can name any function to call. Ours replace the ones that make arrays; all others are refused.
"""

import io
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.session.files.untrusted_files import check_pickle, read_input, rejecting

MAX_BYTES = 1 << 18
"""Maximum size of a file, bytes."""


def read_pickle(path: Path, *, hint: str) -> dict[Any, Any]:
    """Return a pickled dict of arrays, numbers, texts and lists. Raises BadInputError for anything else."""
    data = read_input(path, max_bytes=MAX_BYTES)
    # A malformed pickle may raise anything.
    with rejecting(f"cannot read the calibration {path}", Exception, hint=hint):
        check_pickle(data)
        content = _ArraysOnly(io.BytesIO(data)).load()
        if not isinstance(content, dict):
            raise ValueError("it does not hold camera parameters by name")
    return content


class _ArraysOnly(pickle.Unpickler):
    """Unpickler of arrays and numbers; what it makes is no larger than its bytes."""

    def find_class(self, module: str, name: str) -> Any:
        # Made for each name, as a pickle can set attributes of what it is given.
        makers: dict[tuple[str, str], Callable[..., Any] | None] = {
            ("multiarray", "_reconstruct"): lambda *_: np.empty(0),
            ("multiarray", "scalar"): lambda kind, data: np.frombuffer(data, kind)[0],
            ("numeric", "_frombuffer"): lambda data, kind, shape, order: np.frombuffer(data, kind).reshape(
                shape, order=order
            ),
            ("numpy", "ndarray"): None,
            ("numpy", "dtype"): np.dtype,
            ("_codecs", "encode"): lambda text, _: text.encode("latin-1"),
        }
        key = module.removeprefix("numpy.core.").removeprefix("numpy._core."), name
        if key not in makers:
            raise pickle.UnpicklingError(f"it holds {module}.{name}, which is not an array")
        return makers[key]
