"""People in files: a tidy CSV, and the formats that are installed; and a smoothed copy."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from capture_app.common.errors import NotAvailableError
from capture_app.session.files.durable import write_atomic
from reconstruction.common.geometry import Array
from reconstruction.methods.people.joint_formats import load_writers, rate_of
from reconstruction.methods.people.joint_positions import Person
from reconstruction.methods.people.skeletons import Skeleton

SMOOTHED = "smoothed"
"""Folder of the copies after a low pass."""
MIN_RUN = 4
"""Fewest positions after each other that are smoothed."""
COLUMNS = ("time_s", "person", "joint", "x", "y", "z", "error", "cameras", "reprojection_px")


def write_table(
    path: Path, times_s: Array, skeleton: Skeleton, people: Sequence[Person], *, bias_is_known: bool
) -> None:
    """Write a row for each known joint: time, person, joint, x, y, z, error, cameras, reprojection.

    The column of errors is `error_95` if the detector's bias is in them, else `precision_95`.
    """
    error = "error_95" if bias_is_known else "precision_95"
    lines = [",".join(error if column == "error" else column for column in COLUMNS)]
    for number, person in enumerate(people, 1):
        for row, joint in zip(*np.nonzero(np.isfinite(person.error)), strict=True):
            x, y, z = person.positions[row, joint]
            lines.append(
                f"{times_s[row]:.6f},{number},{skeleton.joints[joint]},{x:.6g},{y:.6g},{z:.6g},"
                f"{person.error[row, joint]:.4g},{person.cameras[row, joint]},"
                f"{person.residual_px[row, joint]:.3g}"
            )
    write_atomic(path, ("\n".join(lines) + "\n").encode())


def file_names() -> set[str]:
    """Return the names of the files and folders that `write_formats` makes."""
    return {name if writer.one_person else f"people.{name}" for name, writer in load_writers().items()}


def write_formats(
    folder: Path,
    times_s: Array,
    skeleton: Skeleton,
    people: Sequence[Array],
    unit: str,
    smooth_hz: float | None,
) -> list[str]:
    """Write people's positions, y up, in all formats, and with a low pass into `SMOOTHED`.

    Return a sentence for each format that is left out, as a package is missing.
    """
    left_out = list[str]()
    low = [smoothed(person, rate_of(times_s), smooth_hz) for person in people] if smooth_hz else []
    for name, writer in load_writers().items():
        try:
            writer.require()
        except NotAvailableError as error:
            left_out.append(f"left out: {error.what}; {error.hint}")
            continue
        for place, positions in ((folder / name, people), (folder / SMOOTHED, low)):
            for number, one in enumerate(positions if writer.one_person else (), 1):
                place.mkdir(exist_ok=True)
                writer.write(place / f"person{number}.{name}", times_s, skeleton, [one], unit)
        if not writer.one_person:
            writer.write(folder / f"people.{name}", times_s, skeleton, people, unit)
    return left_out


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
