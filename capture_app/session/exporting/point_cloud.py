"""Point clouds as PLY: read from COLMAP and Open3D, written for Gaussian splatting."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture_app.common.errors import BadInputError, IncompleteError
from capture_app.session.files.untrusted_files import read_input, rejecting
from capture_app.session.format.lens import Array

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}


@dataclass(frozen=True, slots=True)
class PointCloud:
    """Points (n, 3) in rig coordinates and the calibration's unit, with their colours (n, 3), RGB."""

    points: Array
    colours: NDArray[np.uint8]

    def thinned(self, max_points: int) -> "PointCloud":
        """Return at most `max_points` points, drawn at random with a fixed seed."""
        if len(self.points) <= max_points:
            return self
        chosen = np.sort(np.random.default_rng(0).choice(len(self.points), max_points, replace=False))
        return PointCloud(self.points[chosen], self.colours[chosen])


def read_ply(path: Path) -> PointCloud:
    """Read the vertices of a PLY file; they are grey if the file has no colours.

    Raises IncompleteError if it is missing, BadInputError if it is not a PLY of points.
    """
    if not path.exists():
        raise IncompleteError(f"{path} is missing", hint="a point cloud as PLY belongs there")
    with rejecting(
        f"{path} is not a PLY file of points that can be read",
        *(ValueError, LookupError),
        hint="reconstruct multiview writes point clouds as PLY",
    ):
        vertices = _vertices(read_input(path))
        points = np.stack([vertices[name].astype(np.float64) for name in ("x", "y", "z")], axis=1)
    names = vertices.dtype.names or ()
    colours = np.full((len(points), 3), 128, np.uint8)  # grey
    if all(name in names and vertices[name].dtype == np.uint8 for name in ("red", "green", "blue")):
        colours = np.stack([vertices[name] for name in ("red", "green", "blue")], axis=1)
    chosen = np.isfinite(points).all(axis=1)
    if not chosen.any():
        raise BadInputError(
            f"{path} has no points", hint="give another point cloud, as reconstruct multiview writes it"
        )
    return PointCloud(points[chosen], colours[chosen])


def write_ply(path: Path, cloud: PointCloud, normals: Array | None = None) -> None:
    """Write points, colours and perhaps normals (n, 3), which some programs require; binary little-endian."""
    places = np.asarray(cloud.points) if normals is None else np.hstack([cloud.points, normals])
    floats = ("x", "y", "z", "nx", "ny", "nz")[: places.shape[1]]
    rows = np.zeros(len(places), [("floats", "<f4", len(floats)), ("colour", "u1", 3)])
    rows["floats"], rows["colour"] = places, cloud.colours
    lines = [
        *("ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"),
        *(f"property float {name}" for name in floats),
        *(f"property uchar {name}" for name in ("red", "green", "blue")),
        "end_header\n",
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes("\n".join(lines).encode() + rows.tobytes())


def _vertices(data: bytes) -> NDArray[np.void]:
    head, separator, body = data.partition(b"end_header")
    lines = [line.split() for line in head.decode("ascii").splitlines() if line.strip()]
    if not separator or lines[0] != ["ply"]:
        raise ValueError("no header")
    order = _ORDERS[next((line[1] for line in lines if line[0] == "format"), "no format")]
    elements = [line for line in lines if line[0] == "element"]
    if elements[0][1] != "vertex":
        raise ValueError("vertices are not first")
    count, start = int(elements[0][2]), lines.index(elements[0])
    end = lines.index(elements[1]) if len(elements) > 1 else len(lines)
    fields = [(line[2], order + _TYPES[line[1]]) for line in lines[start:end] if line[0] == "property"]
    body = body[body.index(b"\n") + 1 :]
    if order == "=":
        rows = [tuple(map(float, row.split())) for row in body.decode("ascii").splitlines()[:count]]
        return np.array(rows, fields)
    return np.frombuffer(body, fields, count)
