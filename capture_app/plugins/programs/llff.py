"""LLFF's poses_bounds.npy, as NeRF, Neural 3D Video and their kin read it.

According to the README of github.com/Fyusion/LLFF ("Using your own poses"), a row is a 3 x 5 matrix and two
depths: the camera's down, right and backward axes in the world, its position, and the image's height, width
and focal length in px. The poses are COLMAP's, whose principal point is the image's middle. Rows have the
order of the images' or videos' names.
"""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.files.untrusted_files import read_input, rejecting
from capture_app.session.format.lens import Array
from capture_app.session.importing.importer import Importer, open_images
from capture_app.session.importing.recording_sources import Layout, images_in
from capture_app.session.importing.views import EXPORT_AGAIN, View, Views, pinhole

MAX_BYTES = 1 << 20
"""Maximum size of a file, bytes; a camera has 136."""
MAX_NUMBER = 1e12
"""Numbers of cameras are smaller; products of much larger ones overflow."""
_POSES = "poses_bounds.npy"


def open_recording(path: Path, *, png: bool, recording: str | None) -> Layout | None:
    """Open a scene with a row for each of its images: each is a camera of one instant."""
    source, place = path / _POSES, path / "images"
    count = len(images_in(place)) if source.is_file() and place.is_dir() else 0
    if count < 2 or len(_read_rows(source)) != count:
        return None
    sources = tuple(open_images(place))
    return Layout(
        path=place,
        sources=sources,
        # LLFF's rows are in the order of the files' names.
        views=_views(
            source, [camera.name for camera in sorted(sources, key=lambda camera: camera.path.name)]
        ),
        notes=[f"each of {count} images is a camera of one instant"],
    )


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read a row for each camera, in the order of their names. Raises BadInputError for another number."""
    path = paths[0][1]
    return _views(path, sorted(cameras)) if path.suffix.lower() == ".npy" else None


def _views(path: Path, cameras: Sequence[str]) -> Views:
    """Return the views of cameras in the order of their rows. Raises BadInputError."""
    rows = _read_rows(path)
    if rows.shape != (len(cameras), 17):
        raise BadInputError(
            f"{path} has the shape {rows.shape}, not a row of 17 numbers for each of {len(cameras)} cameras",
            hint="import the images or videos that it was made of, and no other",
        )
    views = {}
    for name, row in zip(cameras, rows, strict=True):
        down, right, back, centre, (height, width, focal) = row[:15].reshape(3, 5).T
        rotation = np.stack([right, down, -back])
        views[name] = View(
            matrix=pinhole(focal, focal, (width - 1) / 2, (height - 1) / 2),
            distortion=np.zeros(5),
            rotation=rotation,
            translation=-rotation @ centre,
            size=(round(width), round(height)),
        )
    return Views(views, f"{path.name}, rows from {cameras[0]} to {cameras[-1]}", assumed_unit="arbitrary")


def _read_rows(path: Path) -> Array:
    """Return the array of a .npy file, no larger than the file. Raises BadInputError."""
    file = io.BytesIO(read_input(path, max_bytes=MAX_BYTES))
    # numpy's header is a Python literal, which can be malformed in many ways.
    with rejecting(f"cannot read {path} as an array (.npy)", Exception, hint=EXPORT_AGAIN):
        np.lib.format.read_magic(file)
        shape, is_by_columns, kind = np.lib.format.read_array_header_1_0(file)
        numbers = np.frombuffer(file.read(), kind).astype(np.float64)
        rows = numbers.reshape(shape, order="F" if is_by_columns else "C")
        if rows.ndim != 2 or not (np.abs(rows) < MAX_NUMBER).all():
            raise ValueError(f"it is not a table of numbers below {MAX_NUMBER:g}")
        return rows


IMPORTER = Importer(
    program="LLFF, Neural 3D Video",
    help="a scene's images, one a camera, with poses_bounds.npy; this as a calibration",
    open_recording=open_recording,
    read_calibration=read_calibration,
    calibration_files=(_POSES,),
)
