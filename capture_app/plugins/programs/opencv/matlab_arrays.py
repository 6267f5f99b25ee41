"""Reader for the arrays of a MAT-file of version 5 to 7.

According to "MAT-File Format" (MathWorks), a file of 128 bytes of header and data elements: a type, a
length and bytes that are padded to 8, or 4 bytes with both before them. An array's element holds flags,
dimensions, a name and its numbers, of which the first index runs fastest. Objects, such as
stereoParameters, are MATLAB's own.
"""

import struct
import zlib
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.files.untrusted_files import read_input, rejecting
from capture_app.session.format.lens import Array

MAX_BYTES, MAX_VARIABLES, MAX_VARIABLE = 1 << 25, 10_000, 1 << 16
"""Maximum size of a file, bytes, number of variables, and unpacked size of one that is read."""
_HEADER = 128
_COMPRESSED = 15
_NUMERIC = range(6, 16)
"""Classes of arrays of numbers."""
_TYPES = dict(zip((1, 2, 3, 4, 5, 6, 7, 9, 12, 13), "bBhHiIfdqQ", strict=True))
"""numpy's type of each type of numbers."""
_NAMES = (
    *("intrinsicMatrix1", "distortionCoefficients1", "intrinsicMatrix2", "distortionCoefficients2"),
    *("rotationOfCamera2", "translationOfCamera2"),
)
_CONVERT = (
    f"in MATLAB: [{', '.join(_NAMES)}] = stereoParametersToOpenCV(stereoParams); "
    f"save stereo.mat {' '.join(_NAMES)} -v7"
)


def read_mat(path: Path) -> dict[str, Array]:
    """Return the arrays of numbers of a MAT-file by name. Raises BadInputError if there are none."""
    data, arrays = read_input(path, max_bytes=MAX_BYTES), {}
    with rejecting(f"cannot read {path}", ValueError, LookupError, struct.error, zlib.error, hint=_CONVERT):
        content = data[_HEADER:] if data.startswith(b"MATLAB 5.0") else b""
        for kind, body in islice(_elements(content), MAX_VARIABLES):
            if kind == _COMPRESSED:
                unpacking = zlib.decompressobj()
                (_, body), *_ = _elements(unpacking.decompress(body, MAX_VARIABLE))
            if len(body) > MAX_VARIABLE or (kind == _COMPRESSED and not unpacking.eof):
                continue
            (_, flags), (_, shape), (_, name), *rest = _elements(body)
            # What MATLAB keeps of its objects is an array without a name.
            if name and flags[0] in _NUMERIC:
                values = np.frombuffer(rest[0][1], _TYPES[rest[0][0]]).astype(np.float64)
                arrays[name.decode()] = values.reshape(np.frombuffer(shape, np.int32), order="F")
    if not arrays:
        raise BadInputError(f"{path} has no arrays that can be read outside MATLAB", hint=_CONVERT)
    return arrays


def _elements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the elements of bytes: type and content."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from("<II", data, at)
        short = kind >> 16
        begin, size = (at + 4, short) if short else (at + 8, size)
        yield kind & 0xFFFF, data[begin : begin + size]
        # Only compressed elements are not padded.
        at = at + 8 if short else begin + size + (0 if kind == _COMPRESSED else -size % 8)
