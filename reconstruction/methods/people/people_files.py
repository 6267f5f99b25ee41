"""People in files of other programs: a tidy CSV, OpenSim's TRC and C3D; and a smoothed copy."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from capture_app.common.optional_packages import load_optional
from capture_app.session.files.durable import write_atomic
from reconstruction.common.geometry import Array
from reconstruction.methods.people.people_run import Person
from reconstruction.methods.people.skeletons import Skeleton

MIN_RUN = 4
"""Fewest positions after each other that are smoothed."""
COLUMNS = ("time_s", "person", "joint", "x", "y", "z", "error_95", "cameras", "reprojection_px")


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


def write_c3d(path: Path, times_s: Array, joints: Sequence[str], positions: Array, unit: str) -> None:
    """Write positions (times, joints, 3) with y up as C3D; a gap's residual is -1.

    C3D stores residuals as whole numbers of its unit, so that errors are in the table alone.

    Raises:
        NotAvailableError: ezc3d is not installed.
    """
    ezc3d = load_optional("ezc3d", "people", "C3D")
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


def smoothed(positions: Array, rate_hz: float, cutoff_hz: float) -> Array:
    """Return positions (times, joints, 3) after a Butterworth low pass of second order, forth and back.

    Gaps stay gaps; each run of known positions is filtered by itself, extended by its reflection. Runs of
    under four positions stay as they are.
    """
    smooth = positions.copy()
    for path, own in zip(positions.transpose(1, 0, 2), smooth.transpose(1, 0, 2), strict=True):
        for run in np.ma.clump_unmasked(np.ma.masked_invalid(path[:, 0])):  # type: ignore[no-untyped-call]
            extra = min(run.stop - run.start - 1, int(2 * rate_hz / cutoff_hz) + 3)
            if extra >= MIN_RUN - 1:
                long = np.pad(path[run], ((extra, extra), (0, 0)), "reflect", reflect_type="odd")
                # Forth and back, the gain of 0.5 ** 0.5 is reached at 0.802 times each pass' own frequency.
                bands = np.fft.rfftfreq(len(long), 1 / rate_hz) / (cutoff_hz / 0.802)
                passed = np.fft.irfft(
                    np.fft.rfft(long, axis=0) / (1 + bands[:, None] ** 4), len(long), axis=0
                )
                own[run] = passed[extra:-extra]
    return smooth
