"""FreeMoCap: a recording folder of synchronized videos, and the calibration in its Anipose format."""

from pathlib import Path

import msgspec

from capture_app.session.exporting.csv_tables import camera_tables, paired_names, renaming_notes
from capture_app.session.exporting.exported_burst import ExportedBurst
from capture_app.session.exporting.exporter import VIDEOS, Exporter
from capture_app.session.exporting.videos import write_paired_videos
from capture_app.session.format.lens import Redraw, redrawing, without_k3

_EXACT_PX = 0.01
"""Maximum error of a fitted lens for which images need not be redrawn."""


def write(burst: ExportedBurst, folder: Path) -> None:
    """Write synchronized_videos/<session>.id-<camera>.idx-N.mp4, equally long, and the calibration.

    FreeMoCap 2 finds a camera by the id in its video's name, FreeMoCap 1 by the order of the names; both use
    millimetres. FreeMoCap 2 reads k1, k2, p1 and p2 and assumes k3 = 0: a lens with k3 is replaced by the
    closest one without, and the images are redrawn if the two differ.
    """
    ids = camera_ids(burst.cameras, burst.name)
    files = {
        camera: f"synchronized_videos/{_stem(burst.name, markers, number)}.mp4"
        for number, (camera, markers) in enumerate(ids.items())
    }
    burst.notes += renaming_notes(ids)
    calibration = burst.calibration
    redraws: dict[str, Redraw | None] = {}
    if calibration is not None:
        fitted = dict(calibration.cameras)
        for name in burst.cameras:
            fitted[name], worst_px = without_k3(calibration.cameras[name])
            if worst_px > _EXACT_PX:
                burst.drawn[name] = fitted[name]
                redraws[name] = redrawing(calibration.cameras[name], fitted[name])
                burst.notes.append(
                    f"{name}: FreeMoCap knows no k3; the pictures are redrawn, by up to {worst_px:.2f} px, "
                    "for the nearest lens without"
                )
        calibration = msgspec.structs.replace(calibration, cameras=fitted)
        (folder / f"{burst.name}_camera_calibration.toml").write_text(
            camera_tables(calibration, ids, "mm", numbered=True), encoding="utf-8"
        )
    write_paired_videos(burst, folder, files, redraws)


def camera_ids(cameras: tuple[str, ...], recording: str) -> dict[str, str]:
    """Return the id in each camera's video name: without dots, and in the same order as the files."""
    ids = {camera: name.replace(".", "_") for camera, name in paired_names(cameras).items()}
    by_id = sorted(ids.values())
    by_file = sorted(by_id, key=lambda camera: _stem(recording, camera, by_id.index(camera)))
    if by_id == by_file == list(ids.values()) and len(set(by_id)) == len(ids):
        return ids
    return {camera: f"cam_{number:03d}" for number, camera in enumerate(paired_names(cameras))}


def _stem(recording: str, camera: str, number: int) -> str:
    return f"{recording}.id-{camera}.idx-{number}"


EXPORTER = Exporter(
    write=write,
    help="synchronized_videos and the camera calibration",
    program="FreeMoCap",
    calibration="optional",
    uncalibrated="the session has no calibration: calibrate in FreeMoCap",
    unit="mm",
    packages=VIDEOS,
)
