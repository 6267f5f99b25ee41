"""C3D, a file for each person, by ezc3d."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_app.common.optional_packages import load_optional
from reconstruction.common.geometry import Array
from reconstruction.methods.people.joint_formats import JointWriter, rate_of
from reconstruction.methods.people.skeletons import Skeleton


def _library() -> Any:
    return load_optional("ezc3d", "people", "C3D")


def write(path: Path, times_s: Array, skeleton: Skeleton, people: Sequence[Array], unit: str) -> None:
    """Write one person's positions; a gap's residual is -1.

    C3D stores residuals as whole numbers of its unit, so that errors are in the table alone.

    Raises:
        NotAvailableError: ezc3d is not installed.
    """
    (positions,), joints, ezc3d = people, skeleton.joints, _library()
    known = np.isfinite(positions[..., 0])
    file = ezc3d.c3d()
    points = np.ones((4, len(joints), len(times_s)))
    points[:3] = positions.transpose(2, 1, 0)
    file["data"]["points"] = points
    file["data"]["meta_points"]["residuals"] = np.where(known, 0, -1).T[None]
    for name, value in (
        ("RATE", [rate_of(times_s)]),
        ("LABELS", tuple(joints)),
        ("UNITS", [unit]),
        ("X_SCREEN", ["+X"]),
        ("Y_SCREEN", ["+Y"]),
    ):
        file.add_parameter("POINT", name, value)
    file.write(str(path))


WRITER = JointWriter(write=write, require=_library)
