"""Caliscope: a workspace with one recording, its frames' times, and the camera array."""

import re
from pathlib import Path

from capture_app.session.exporters.common.exported_burst import ExportedBurst, ExportOptions
from capture_app.session.exporters.common.lens import distortion_of, matrix_of, rodrigues, rotation_of
from capture_app.session.exporters.common.tables import renaming_notes, toml_table, unit_note, write_frames
from capture_app.session.exporters.common.videos import write_timeline
from capture_app.session.format.calibration import METRES, Calibration


def write(burst: ExportedBurst, folder: Path, options: ExportOptions) -> list[str]:
    """Write recordings/<session>/cam_N.mp4 and timestamps.csv, and camera_array.toml where calibrated.

    Cameras keep the numbers of names such as cam_3, else they are numbered in the session's order from 0;
    frame_time is in seconds since the earliest image.
    Caliscope matches frames by frame_time; sync_index, the session's instant, is there for others.
    """
    recording = folder / "recordings" / burst.name
    recording.mkdir(parents=True)
    frames, rows = [], ["sync_index,cam_id,frame_time\n"]
    numbers = camera_numbers(burst.cameras)
    for camera, number in numbers.items():
        file = f"recordings/{burst.name}/cam_{number}.mp4"
        frames += write_timeline(burst, camera, folder / file, file, options)
        for image in burst.images_of(camera):
            seconds, nanos = divmod(image.leader_ns - burst.origin_ns, 10**9)
            rows.append(f"{image.instant},{number},{seconds}.{nanos:09d}\n")
    (recording / "timestamps.csv").write_text("".join(rows), encoding="utf-8")
    write_frames(burst, folder, frames)
    notes = renaming_notes({camera: f"cam_{number}" for camera, number in numbers.items()})
    if burst.session.calibration() is None:
        return [*notes, "the session has no calibration: calibrate in Caliscope"]
    calibration = burst.calibration("Caliscope")
    (folder / "camera_array.toml").write_text(_camera_array(numbers, calibration), encoding="utf-8")
    return notes + unit_note(calibration, "m")


def camera_numbers(cameras: tuple[str, ...]) -> dict[str, int]:
    """Caliscope's number of each camera: that of its name where all have one, else its place."""
    found = [re.fullmatch(r"cam_?([0-9]{1,6})", name) for name in cameras]
    given = [int(match[1]) for match in found if match]
    if len(set(given)) == len(cameras):
        return dict(zip(cameras, given, strict=True))
    return {name: number for number, name in enumerate(cameras)}


def _camera_array(numbers: dict[str, int], calibration: Calibration) -> str:
    factor = METRES.get(calibration.unit, 1.0)
    text = ""
    for name, number in numbers.items():
        camera = calibration.cameras[name]
        text += toml_table(
            ["cameras", str(number)],
            {
                "cam_id": number,
                "size": [camera.width, camera.height],
                "rotation_count": 0,
                "ignore": False,
                "matrix": matrix_of(camera).tolist(),
                "distortions": distortion_of(camera).tolist(),
                "translation": [float(value) * factor for value in camera.translation],
                "rotation": list(rodrigues(rotation_of(camera))),
                "fisheye": False,
            },
        )
    return text
