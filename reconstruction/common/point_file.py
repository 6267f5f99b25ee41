"""Coloured points as a binary PLY file, which every viewer of point clouds opens."""

from pathlib import Path

import numpy as np

from capture_app.errors import BadInputError
from reconstruction.common.geometry import Array

VERTEX = np.dtype([("at", "<f4", 3), ("colour", "u1", 3)])
HEADER = """ply
format binary_little_endian 1.0
element vertex {count}
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
end_header
"""


def write_points(path: Path, points: Array, colours: Array) -> None:
    """Write points (n, 3) and their colours (n, 3) uint8 RGB."""
    rows = np.empty(len(points), VERTEX)
    rows["at"], rows["colour"] = points, colours
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(HEADER.format(count=len(rows)).encode() + rows.tobytes())


def read_points(path: Path) -> tuple[Array, Array]:
    """The points and colours of a file that `write_points` made.

    Raises:
        BadInputError: it is missing or another kind of file.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BadInputError(f"cannot read the cloud {path}: {error.strerror or error}") from error
    count = (len(data) - len(HEADER.format(count=""))) // VERTEX.itemsize
    start = HEADER.format(count=count).encode()
    if not data.startswith(start) or len(data) != len(start) + count * VERTEX.itemsize:
        raise BadInputError(
            f"{path} is not a cloud as a comparison writes it", hint="compare the session again"
        )
    rows = np.frombuffer(data, VERTEX, offset=len(start))
    return np.array(rows["at"]), np.array(rows["colour"])
