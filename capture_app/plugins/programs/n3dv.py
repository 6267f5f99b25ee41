"""Neural 3D Video: camNN.mp4, one frame an instant, poses_bounds.npy as LLFF defined it, and points."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.exporting.csv_tables import renaming_notes
from capture_app.session.exporting.exported_burst import ExportedBurst
from capture_app.session.exporting.exporter import VIDEOS, Exporter, ExportOptions, Option, Points
from capture_app.session.exporting.point_cloud import PointCloud, read_ply, write_ply
from capture_app.session.exporting.videos import at_instants, spacing_notes, write_camera
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.lens import (
    Array,
    centre_of,
    nearest_point,
    picture_rays,
    project_rays,
    rays_of,
    redrawing,
    rotation_of,
    translation_of,
)

WIDTH, HEIGHT = 2704, 2028
"""Size of Neural 3D Video's own videos; its loaders assume this size for every video and scale by it."""
POINTS = "points3D_downsample2.ply"
"""File name of the initial points in 4DGaussians' loader."""

_MAX_POINTS = 40_000
_MAX_FRAMES = 300
_NEAR, _FAR = 0.2, 5.0
"""Guessed bounds, relative to the distance at which the cameras' axes meet."""
_NARROWER = 0.99
"""Step factor in the search for a field of view."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Options(ExportOptions):
    points: Points = None
    whole: Annotated[
        bool, Option("whole pictures with black around them, not cut to what fills all films")
    ] = False
    near: Annotated[float | None, Option("smallest depth, in the calibration's unit", "DEPTH")] = None
    far: Annotated[float | None, Option("largest depth", "DEPTH")] = None


def write(burst: ExportedBurst, folder: Path, options: _Options) -> None:
    """Write the videos of the instants that every camera has, and a row of 17 numbers for each camera.

    The format's loaders assume one focal length, no distortion, a centred principal point, and videos of
    2704x2028 px. The images are redrawn to that, cropped to what all cameras can fill, or uncropped.
    """
    calibration, together = burst.calibration, burst.complete_instants()
    assert calibration is not None
    cameras = {name: calibration.cameras[name] for name in burst.cameras}
    focal = (
        min(map(_whole_focal, cameras.values())) if options.whole else max(map(_min_focal, cameras.values()))
    )
    bounds = {name: _bounds(options, depth) for name, depth in focus_depths(cameras).items()}
    film_cameras = {name: film_camera(camera, focal) for name, camera in cameras.items()}
    burst.drawn.update(film_cameras)
    for number, (name, camera) in enumerate(cameras.items()):
        path, redraw = folder / f"cam{number:02d}.mp4", redrawing(camera, film_cameras[name])
        shown = at_instants(burst, name, together)
        write_camera(burst, path, shown, name, redraw=redraw, size=(WIDTH, HEIGHT))
    rows = [[*_pose(film).ravel(), *bounds[name]] for name, film in film_cameras.items()]
    np.save(folder / "poses_bounds.npy", np.array(rows, np.float64))
    cloud = read_ply(options.points) if options.points else _scattered(film_cameras, bounds)
    cloud = cloud.thinned(_MAX_POINTS)
    write_ply(folder / POINTS, cloud, np.zeros_like(cloud.points))
    _add_notes(
        burst, options, together, min(_fraction_shown(cameras[name], film_cameras[name]) for name in cameras)
    )


def film_camera(camera: CameraCalibration, focal: float) -> CameraCalibration:
    """Return a camera at the same pose with a Neural 3D Video lens: `focal` px, no distortion."""
    return msgspec.structs.replace(
        camera,
        width=WIDTH,
        height=HEIGHT,
        fx=focal,
        fy=focal,
        cx=(WIDTH - 1) / 2,
        cy=(HEIGHT - 1) / 2,
        distortion=(0.0,) * 5,
    )


def focus_depths(cameras: Mapping[str, CameraCalibration]) -> dict[str, float]:
    """Return for each camera the depth, in the calibration's unit, of the point nearest to all optical axes.

    If the axes do not meet in front of the cameras, it is ten times the largest distance between two cameras.
    """
    centres = np.array([centre_of(camera) for camera in cameras.values()])
    axes = np.array([rotation_of(camera)[2] for camera in cameras.values()])
    widest = max((float(np.linalg.norm(a - b)) for a in centres for b in centres), default=0.0)
    if (point := nearest_point(centres, axes, 1e4)) is not None:
        depths = np.einsum("nj,nj->n", axes, point - centres)
        if depths.min() > 0:
            return dict(zip(cameras, map(float, depths), strict=True))
    return dict.fromkeys(cameras, 10 * widest or 1.0)


def _whole_focal(camera: CameraCalibration) -> float:
    """Return the longest focal length, px, at which a video shows the camera's whole image."""
    return float((np.array([WIDTH / 2, HEIGHT / 2]) / np.abs(picture_rays(camera)).max(axis=0)).min())


def _min_focal(camera: CameraCalibration) -> float:
    """Return the shortest focal length, px, at which the camera's image still fills the video."""
    across, down = np.linspace(-WIDTH / 2, WIDTH / 2, 41), np.linspace(-HEIGHT / 2, HEIGHT / 2, 41)
    edge = [(x, y) for x in across for y in (down[0], down[-1])]
    edge += [(x, y) for y in down for x in (across[0], across[-1])]
    half = np.array([camera.width, camera.height]) / 2

    def fills(focal: float) -> bool:
        seen = project_rays(camera, np.array(edge) / focal)
        return bool((np.abs(seen - (half - 0.5)) <= half + 1e-6).all())

    # Search from a narrow view outwards: far outside its image a lens's polynomial may map rays back into it.
    focal = 100 * max(WIDTH / camera.width, HEIGHT / camera.height) * max(camera.fx, camera.fy)
    if not fills(focal):
        raise BadInputError(
            f"N3DV cannot hold a principal point outside the picture, ({camera.cx:.0f}, {camera.cy:.0f})",
            hint="calibrate again",
        )
    while fills(focal * _NARROWER):
        focal *= _NARROWER
    low, high = focal * _NARROWER, focal
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (low, middle) if fills(middle) else (middle, high)
    return high


def _bounds(options: _Options, depth: float) -> tuple[float, float]:
    near, far = options.near or _NEAR * depth, options.far or _FAR * depth
    if near >= far:
        raise BadInputError(
            f"the nearest depth, {near:.4g}, is not less than the farthest, {far:.4g}",
            hint="give a smaller --near or a larger --far",
        )
    return near, far


def _pose(camera: CameraCalibration) -> Array:
    """Return LLFF's 3x5: the camera's down, right and back axes, its centre, and (height, width, focal)."""
    right, down, forward = rotation_of(camera)
    intrinsics = np.array([camera.height, camera.width, camera.fx], np.float64)
    return np.stack([down, right, -forward, centre_of(camera), intrinsics], axis=1)


def _scattered(
    cameras: Mapping[str, CameraCalibration], bounds: Mapping[str, tuple[float, float]]
) -> PointCloud:
    """Return grey points, uniform in the cameras' views between near and far, for scenes without points."""
    random = np.random.default_rng(0)
    per_camera = _MAX_POINTS // len(cameras)
    points = []
    for name, camera in cameras.items():
        near, far = bounds[name]
        depth = (random.uniform(near**3, far**3, per_camera)) ** (1 / 3)
        rays = rays_of(camera, random.uniform(0, [WIDTH - 1, HEIGHT - 1], (per_camera, 2)))
        local = np.column_stack([rays, np.ones(per_camera)]) * depth[:, None]
        points.append((local - translation_of(camera)) @ rotation_of(camera))
    every = np.concatenate(points)
    return PointCloud(every, np.full(every.shape, 128, np.uint8))


def _fraction_shown(camera: CameraCalibration, film: CameraCalibration) -> float:
    """Return the fraction of a camera's image that its video shows."""
    seen = project_rays(film, picture_rays(camera))
    return float(((seen > -0.51) & (seen < [WIDTH - 0.49, HEIGHT - 0.49])).all(axis=1).mean())


def _add_notes(burst: ExportedBurst, options: _Options, together: list[int], min_shown: float) -> None:
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
        (
            options.points is None,
            f"{POINTS} has random points: `--points` takes the cloud of reconstruct multiview",
        ),
        (
            options.near is None or options.far is None,
            "near and far are guessed from where the cameras look; `sessions export` takes --near and --far",
        ),
    )
    burst.notes += [note for applies, note in conditional_notes if applies]
    burst.notes += spacing_notes([burst.instants_ns[instant] for instant in together], burst.period_ns)


EXPORTER = Exporter(
    write=write,
    help="Neural 3D Video, 4DGaussians: camNN.mp4, poses, points",
    program="N3DV",
    options=_Options,
    calibration="required",
    complete_instants=True,
    packages=VIDEOS,
)
