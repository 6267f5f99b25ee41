"""Neural 3D Video: camNN.mp4, one frame an instant, poses_bounds.npy as LLFF defined it, and points."""

from pathlib import Path
from typing import Annotated

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.exporting.csv_tables import renaming_notes
from capture_app.session.exporting.exported_burst import ExportedBurst
from capture_app.session.exporting.exporter import VIDEOS, Exporter, Option, Points
from capture_app.session.exporting.pinhole import centred_pinhole, focus_depths, llff_row, min_focal
from capture_app.session.exporting.point_cloud import read_ply, write_ply
from capture_app.session.exporting.starting_points import scatter_points
from capture_app.session.exporting.videos import at_instants, spacing_notes, write_camera
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.lens import lens_of, picture_rays, redrawing

WIDTH, HEIGHT = 2704, 2028
"""Size of Neural 3D Video's own videos; its loaders assume this size for every video and scale by it."""
POINTS = "points3D_downsample2.ply"
"""File name of the initial points in 4DGaussians' loader."""

_MAX_POINTS = 40_000
_MAX_FRAMES = 300
_NEAR, _FAR = 0.2, 5.0
"""Guessed bounds, relative to the distance at which the cameras' axes meet."""


def write(
    burst: ExportedBurst,
    folder: Path,
    *,
    points: Points = None,
    whole: Annotated[
        bool, Option("whole pictures with black around them, not cut to what fills all films")
    ] = False,
    near: Annotated[float | None, Option("smallest depth, in the calibration's unit", "DEPTH")] = None,
    far: Annotated[float | None, Option("largest depth", "DEPTH")] = None,
) -> None:
    """Write the videos of the instants that every camera has, and a row of 17 numbers for each camera.

    The format's loaders assume one focal length, no distortion, a centred principal point, and videos of
    2704x2028 px. The images are redrawn to that, cropped to what all cameras can fill, or uncropped.
    """
    calibration, together = burst.required_calibration, burst.complete_instants()
    cameras = {name: calibration.cameras[name] for name in burst.cameras}
    focal = (
        min(map(_whole_focal, cameras.values()))
        if whole
        else max(min_focal(lens, WIDTH, HEIGHT) for lens in cameras.values())
    )
    bounds = {name: _bounds(near, far, depth) for name, depth in focus_depths(cameras).items()}
    film_cameras = {name: centred_pinhole(camera, WIDTH, HEIGHT, focal) for name, camera in cameras.items()}
    burst.drawn.update(film_cameras)
    for number, (name, camera) in enumerate(cameras.items()):
        path, redraw = folder / f"cam{number:02d}.mp4", redrawing(camera, film_cameras[name])
        shown = at_instants(burst, name, together)
        write_camera(burst, path, shown, name, redraw=redraw, size=(WIDTH, HEIGHT))
    rows = [llff_row(film, *bounds[name]) for name, film in film_cameras.items()]
    np.save(folder / "poses_bounds.npy", np.array(rows))
    cloud = read_ply(points) if points else scatter_points(film_cameras, bounds, _MAX_POINTS)
    cloud = cloud.thinned(_MAX_POINTS)
    write_ply(folder / POINTS, cloud, np.zeros_like(cloud.points))
    _add_notes(burst, together, min(_fraction_shown(cameras[name], film_cameras[name]) for name in cameras))
    if points is None:
        burst.notes.append(f"{POINTS} has random points: `--points` takes the cloud of reconstruct multiview")
    if near is None or far is None:
        burst.notes.append(
            "near and far are guessed from where the cameras look; `sessions export` takes --near and --far"
        )


def _whole_focal(camera: CameraCalibration) -> float:
    """Return the longest focal length, px, at which a video shows the camera's whole image."""
    return float((np.array([WIDTH / 2, HEIGHT / 2]) / np.abs(picture_rays(camera)).max(axis=0)).min())


def _bounds(near: float | None, far: float | None, depth: float) -> tuple[float, float]:
    near, far = near or _NEAR * depth, far or _FAR * depth
    if near >= far:
        raise BadInputError(
            f"the nearest depth, {near:.4g}, is not less than the farthest, {far:.4g}",
            hint="give a smaller --near or a larger --far",
        )
    return near, far


def _fraction_shown(camera: CameraCalibration, film: CameraCalibration) -> float:
    """Return the fraction of a camera's image that its video shows."""
    seen = lens_of(film).project(picture_rays(camera))
    return float(((seen > -0.51) & (seen < [WIDTH - 0.49, HEIGHT - 0.49])).all(axis=1).mean())


def _add_notes(burst: ExportedBurst, together: list[int], min_shown: float) -> None:
    """Add notes on what the videos lack.

    `together` are the instants of the videos, `min_shown` is the smallest fraction of an image that they
    show.
    """
    burst.notes += renaming_notes({camera: f"cam{number:02d}" for number, camera in enumerate(burst.cameras)})
    left_out = len(burst.instants_ns) - len(together)
    conditional_notes = (
        (
            left_out,
            f"{left_out} of {len(burst.instants_ns)} instants are left out: not every camera has them",
        ),
        (len(together) > _MAX_FRAMES, f"4DGaussians reads the first {_MAX_FRAMES} frames only"),
        (
            min_shown < 0.995,
            f"the films are cut to 4:3 and one angle of view: at least {100 * min_shown:.0f} % of a picture; "
            "`--whole` shows all, and black around it",
        ),
    )
    burst.notes += [note for applies, note in conditional_notes if applies]
    burst.notes += spacing_notes([burst.instants_ns[instant] for instant in together], burst.period_ns)


EXPORTER = Exporter(
    fisheyes=True,
    write=write,
    help="Neural 3D Video, 4DGaussians: camNN.mp4, poses, points",
    program="N3DV",
    calibration="required",
    complete_instants=True,
    packages=VIDEOS,
)
