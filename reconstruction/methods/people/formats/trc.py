"""OpenSim's TRC, a file for each person."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from capture_app.session.files.durable import write_atomic
from reconstruction.common.geometry import Array
from reconstruction.methods.people.joint_formats import JointWriter, rate_of
from reconstruction.methods.people.skeletons import Skeleton


def write(path: Path, times_s: Array, skeleton: Skeleton, people: Sequence[Array], unit: str) -> None:
    """Write one person's positions; gaps are empty."""
    (positions,), joints = people, skeleton.joints
    rate, number = f"{rate_of(times_s):.6g}", len(times_s)
    columns = [f"{axis}{joint}" for joint in range(1, len(joints) + 1) for axis in "XYZ"]
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{number}\t{len(joints)}\t{unit}\t{rate}\t1\t{number}",
        "Frame#\tTime\t" + "\t\t\t".join(joints) + "\t\t",
        "\t\t" + "\t".join(columns),
        "",
    ]
    for row, (at_s, place) in enumerate(zip(times_s, positions.reshape(number, -1), strict=True), 1):
        values = ["" if np.isnan(value) else f"{value:.6f}" for value in place]
        lines.append("\t".join([f"{row}", f"{at_s:.6f}", *values]))
    write_atomic(path, ("\n".join(lines) + "\n").encode())


WRITER = JointWriter(write=write)
