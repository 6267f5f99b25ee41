"""FreeMoCap 1's joints in images, an array of all cameras in the order of their names.

According to its recording folder structure, `output_data/raw_data` has
`mediapipe_2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy`: cameras x frames x points x 2 or more, NaN
if unseen. Its first 33 points are those of MediaPipe's pose, the others of hands and face.
"""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from capture_app.session.files.untrusted_files import read_input, rejecting
from reconstruction.methods.people.joint_formats import JointReader, Labels, bounded
from reconstruction.methods.people.skeletons import SKELETONS, skeleton_of


def read(files: Sequence[Path]) -> list[Labels] | None:
    """Return the labels of each camera; None if the file's name is another's."""
    if "2dData" not in files[0].name:
        return None
    data = io.BytesIO(read_input(files[0]))
    # What does not parse raises a dozen kinds. NumPy's own reader would allocate all that the header claims.
    with rejecting(f"{files[0]} is not an array", Exception):
        np.lib.format.read_magic(data)
        shape, by_columns, kind = np.lib.format.read_array_header_1_0(data)
    array = np.frombuffer(data.read(), kind).reshape(bounded(*shape), order="F" if by_columns else "C")
    body = SKELETONS["blazepose"]
    skeleton = body if "mediapipe" in files[0].name else skeleton_of(array.shape[2])
    pixels = np.asarray(array[:, :, : len(skeleton.joints), :2], float)
    seen = np.isfinite(pixels).all(axis=3).astype(float)
    return [
        Labels(skeleton, range(len(own)), own[:, None], confidence[:, None])
        for own, confidence in zip(pixels, seen, strict=True)
    ]


READER = JointReader(program="FreeMoCap", suffixes=(".npy",), read=read)
