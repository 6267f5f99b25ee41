"""Caliscope: a workspace with one recording, its frames' times, and the camera array."""

import re
from pathlib import Path

from capture_app.session.exporting.csv_tables import camera_table, renaming_notes, toml_table
from capture_app.session.exporting.exported_burst import ExportedBurst
from capture_app.session.exporting.exporter import VIDEOS, Exporter
from capture_app.session.exporting.videos import at_own_times, write_camera


def write(burst: ExportedBurst, folder: Path) -> None:
    """Write recordings/<session>/cam_N.mp4 and timestamps.csv, and camera_array.toml if calibrated.

    Cameras keep the numbers of names such as cam_3, otherwise they are numbered in the session's order from
    0; frame_time is in seconds since the earliest image.

    Caliscope matches frames by frame_time; sync_index, the session's instant, is for other programs.
    """
    recording = folder / "recordings" / burst.name
    recording.mkdir(parents=True)
    rows = ["sync_index,cam_id,frame_time\n"]
    numbers = camera_numbers(burst.cameras)
    for camera, number in numbers.items():
        file = f"recordings/{burst.name}/cam_{number}.mp4"
        shown = at_own_times(burst, camera)
        write_camera(burst, folder / file, shown, camera, file=file)
        rows += [f"{n},{number},{at // 10**9}.{at % 10**9:09d}\n" for n, at, _ in shown]
    (recording / "timestamps.csv").write_text("".join(rows), encoding="utf-8")
    burst.notes += renaming_notes({camera: f"cam_{number}" for camera, number in numbers.items()})
    if burst.calibration is not None:
        tables = {
            str(number): {"cam_id": number, "rotation_count": 0, "ignore": False}
            | camera_table(burst.calibration, camera, "m")
            for camera, number in numbers.items()
        }
        (folder / "camera_array.toml").write_text(
            "".join(toml_table(["cameras", key], table) for key, table in tables.items()), encoding="utf-8"
        )


def camera_numbers(cameras: tuple[str, ...]) -> dict[str, int]:
    """Return Caliscope's number of each camera: from its name if every name has one, otherwise its index."""
    matches = (re.fullmatch(r"cam_?([0-9]{1,6})", name) for name in cameras)
    given = [int(match[1]) for match in matches if match]
    numbers = given if len(set(given)) == len(cameras) else range(len(cameras))
    return dict(zip(cameras, numbers, strict=True))


EXPORTER = Exporter(
    write=write,
    help="recordings, timestamps.csv and camera_array.toml",
    program="Caliscope",
    calibration="optional",
    fisheyes=True,
    uncalibrated="the session has no calibration: calibrate in Caliscope",
    unit="m",
    packages=VIDEOS,
)
