"""Text files of an export: exact times as CSV, and calibrated cameras as TOML and in OpenCV's YAML."""

import csv
import io
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from capture_app.common.names import natural_order
from capture_app.session.exporting.exported_burst import ExportedBurst
from capture_app.session.format.calibration import METRES, Calibration
from capture_app.session.format.export_record import FRAMES
from capture_app.session.format.lens import (
    Array,
    distortion_of,
    matrix_of,
    rodrigues,
    rotation_of,
    translation_of,
)
from capture_app.session.format.manifest import ImageRecord

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_RESERVED = ("metadata", "capture_volume", "charuco", "checkerboard")
"""Tables in these programs' calibrations that are not cameras."""

_TIMES = ("leader_ns", "residual_ns", "uncertainty_ns", "hard_bound_ns")


def write_frames(burst: ExportedBurst, folder: Path) -> None:
    """Write `frames.csv`: a row for every camera and instant of the session, exported or not."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["file", "frame", "camera", "instant", "content", *_TIMES])
    for instant in range(len(burst.instants_ns)):
        for camera in burst.cameras:
            image = burst.recorded.get((camera, instant))
            file, number, shown = burst.frames.get((camera, instant), ("", None, image))
            times = [getattr(image, name, None) for name in _TIMES]  # csv writes None as an empty cell
            rows.writerow([file, number, camera, instant, _content(file, shown), *times])
    (folder / FRAMES).write_text(text.getvalue(), encoding="utf-8")


def paired_names(cameras: Iterable[str]) -> dict[str, str]:
    """Return for each camera the name of its video and its table, in the order in which programs pair them.

    It is the camera's own name, unless alphabetical and numerical order differ or the name is reserved.
    """
    by_letters = sorted(cameras)
    by_numbers = sorted(by_letters, key=natural_order)
    if by_letters == by_numbers and not set(by_letters) & set(_RESERVED):
        return {name: name for name in by_letters}
    return {name: f"cam_{number:03d}_{name}" for number, name in enumerate(by_numbers)}


def renaming_notes(names: Mapping[str, str]) -> list[str]:
    """Return notes for the user on cameras that have a different name in the export."""
    return [f"{name} is {camera}" for camera, name in names.items() if name != camera]


def camera_tables(
    calibration: Calibration, names: Mapping[str, str], unit: str, *, numbered: bool = False
) -> str:
    """Return Anipose's TOML, which FreeMoCap and Pose2Sim read: a table a camera, with Rodrigues vectors.

    `names` are `paired_names`; translations are written in `unit` if the calibration's unit is a length.
    `numbered` adds the id and the index by which FreeMoCap 2 finds a camera.
    """
    tables = {
        key: {
            "name": key,
            **({"id": key, "index": number} if numbered else {}),
            **camera_table(calibration, name, unit),
        }
        for number, (name, key) in enumerate(names.items())
    } | {"metadata": {"adjusted": False, "error": 0.0}}
    return "".join(toml_table([key], table) for key, table in tables.items())


def camera_table(calibration: Calibration, name: str, unit: str) -> dict[str, object]:
    """Return one camera of such a table: its size, lens, and pose with a Rodrigues vector."""
    camera = calibration.cameras[name]
    factor = METRES[calibration.unit] / METRES[unit] if calibration.unit in METRES else 1.0
    return {
        "size": [camera.width, camera.height],
        "matrix": matrix_of(camera).tolist(),
        "distortions": distortion_of(camera).tolist(),
        "rotation": rodrigues(rotation_of(camera)),
        "translation": [float(value) * factor for value in camera.translation],
        "fisheye": camera.is_fisheye,
    }


def toml_table(name: Sequence[str], values: Mapping[str, object]) -> str:
    """Return the TOML table at the path `name`: numbers, booleans, strings and lists, written as in JSON."""
    lines = (f"{key} = {json.dumps(value)}\n" for key, value in values.items())
    title = ".".join(part if _BARE.fullmatch(part) else json.dumps(part) for part in name)
    return f"[{title}]\n{''.join(lines)}\n"


def _content(file: str, image: ImageRecord | None) -> str:
    if image is None:
        return "blank" if file else "missing"
    shown = "substitute" if image.substitute else "image"
    return shown if file else "left out"


def yaml_names(cameras: Iterable[str]) -> dict[str, str]:
    """Return for each camera a name that is valid in a FileStorage key: `paired_names`, without dots."""
    names = {camera: name.replace(".", "_") for camera, name in paired_names(cameras).items()}
    unique = len(set(names.values())) == len(names)
    return names if unique else {camera: f"cam_{number:03d}" for number, camera in enumerate(names)}


def write_cameras(folder: Path, calibration: Calibration, names: Mapping[str, str], centre: float) -> None:
    """Write intri.yml and extri.yml, in metres if the calibration's unit is a length.

    `centre` is the reader's coordinate of the first pixel's centre: 0 in OpenCV, or 0.5.
    """
    metres = METRES.get(calibration.unit, 1.0)
    head = "%YAML:1.0\n---\nnames:\n" + "".join(f'  - "{name}"\n' for name in names.values())
    intri, extri = head, head
    for camera_name, name in names.items():
        camera = calibration.cameras[camera_name]
        matrix = matrix_of(camera)
        matrix[:2, 2] += centre
        intri += _matrix(f"K_{name}", matrix) + _matrix(f"dist_{name}", distortion_of(camera)[None])
        intri += f"H_{name}: {camera.height}\nW_{name}: {camera.width}\n"
        rotation = rotation_of(camera)
        extri += (
            _matrix(f"R_{name}", [[value] for value in rodrigues(rotation)])
            + _matrix(f"Rot_{name}", rotation)
            + _matrix(f"T_{name}", (translation_of(camera) * metres)[:, None])
        )
    (folder / "intri.yml").write_text(intri, encoding="utf-8")
    (folder / "extri.yml").write_text(extri, encoding="utf-8")


def _matrix(key: str, rows: Array | list[list[float]]) -> str:
    values = ", ".join(repr(float(value)) for row in rows for value in row)
    return (
        f"{key}: !!opencv-matrix\n  rows: {len(rows)}\n  cols: {len(rows[0])}\n  dt: d\n  data: [{values}]\n"
    )
