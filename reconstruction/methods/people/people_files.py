"""People in files of other programs: a tidy CSV, TRC of OpenSim, C3D, and a glTF that moves."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from capture_app.session.files.durable import write_atomic
from reconstruction.common.geometry import Array
from reconstruction.methods.people.people_run import Person
from reconstruction.methods.people.skeletons import Skeleton

COLUMNS = ("time_s", "person", "joint", "x", "y", "z", "error_95", "cameras", "reprojection_px")
BONE_WIDTH = 0.04
"""Width of a bone in the glTF, relative to the median length of all bones times four."""
_FLOAT, _UINT, _USHORT = 5126, 5125, 5123


def write_table(path: Path, times_s: Array, skeleton: Skeleton, people: Sequence[Person]) -> None:
    """Write a row for each known joint: time, person, joint, x, y, z, error (95 %), cameras, reprojection."""
    lines = [",".join(COLUMNS)]
    for number, person in enumerate(people, 1):
        for row, joint in zip(*np.nonzero(np.isfinite(person.error)), strict=True):
            x, y, z = person.positions[row, joint]
            lines.append(
                f"{times_s[row]:.6f},{number},{skeleton.joints[joint]},{x:.6g},{y:.6g},{z:.6g},"
                f"{person.error[row, joint]:.4g},{person.cameras[row, joint]},"
                f"{person.residual_px[row, joint]:.3g}"
            )
    write_atomic(path, ("\n".join(lines) + "\n").encode())


def rate_of(times_s: Array) -> float:
    """Return the mean rate of times, Hz; 1 for a single one."""
    return float((len(times_s) - 1) / (times_s[-1] - times_s[0])) if len(times_s) > 1 else 1.0


def write_trc(path: Path, times_s: Array, joints: Sequence[str], positions: Array, unit: str) -> None:
    """Write positions (times, joints, 3) with y up as OpenSim's TRC; gaps are empty."""
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
