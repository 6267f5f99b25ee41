"""intri.yml and extri.yml, the cameras of EasyMocap and EasyVolcap, as OpenCV's FileStorage reads them."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from capture_app.session.exporters.common.poses import (
    Array,
    distortion_of,
    matrix_of,
    rodrigues,
    rotation_of,
    translation_of,
)
from capture_app.session.exporters.common.tables import paired_names
from capture_app.session.format.calibration import METRES, Calibration


def yaml_names(cameras: Iterable[str]) -> dict[str, str]:
    """For each camera a name that FileStorage allows in a key: `paired_names`, without dots."""
    names = {camera: name.replace(".", "_") for camera, name in paired_names(cameras).items()}
    if len(set(names.values())) == len(names):
        return names
    return {camera: f"cam_{number:03d}" for number, camera in enumerate(names)}


def write_cameras(folder: Path, calibration: Calibration, names: Mapping[str, str], centre: float) -> None:
    """Write intri.yml and extri.yml, in metres where the calibration's unit is a length.

    `centre` is where the reader has the first pixel's centre: 0 after OpenCV, or 0.5.
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
        extri += _matrix(f"R_{name}", [[value] for value in rodrigues(rotation)])
        extri += _matrix(f"Rot_{name}", rotation)
        extri += _matrix(f"T_{name}", (translation_of(camera) * metres)[:, None])
    (folder / "intri.yml").write_text(intri, encoding="utf-8")
    (folder / "extri.yml").write_text(extri, encoding="utf-8")


def _matrix(key: str, rows: Array | list[list[float]]) -> str:
    values = ", ".join(repr(float(value)) for row in rows for value in row)
    return (
        f"{key}: !!opencv-matrix\n  rows: {len(rows)}\n  cols: {len(rows[0])}\n  dt: d\n  data: [{values}]\n"
    )
