"""Following of a moving object in a session, and its path as a table."""

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from capture_app.common.errors import NotApplicableError
from capture_app.console.terminal import Progress
from capture_app.session.files.durable import write_atomic
from reconstruction.common.geometry import SIGMAS_95, Array
from reconstruction.methods.trajectory.moving_point import find_moving_points
from reconstruction.methods.trajectory.spline_path import OUTLIER, Rays, choose_path
from reconstruction.scene.calibration.consistency import REFUSED_PX
from reconstruction.scene.pairs import size_above_features
from reconstruction.scene.provenance import Provenance
from reconstruction.scene.scene import Scene
from reconstruction.time_offsets.camera_time import ImageTimes

TABLE = "trajectory.csv"
OURS = {TABLE}
MIN_FRAMES = 8
MAX_OUTLIERS = 0.4
"""Fraction of outliers from which on the cameras do not see one object."""
TOGETHER_MS = 1.0
"""Frames that are no farther apart are of one moment."""


class PathPoint(msgspec.Struct, frozen=True):
    """The object at one moment."""

    leader_ns: int
    position: tuple[float, float, float]
    """In the rig's frame and the calibration's unit."""
    uncertainty: float
    """95 % uncertainty along the least certain direction."""


class TrajectoryResult(Provenance, frozen=True, kw_only=True):
    """An object's path; written to trajectory.json and printed by --json."""

    session: str
    unit: str
    cameras: dict[str, int]
    """Frames of each camera in which the object was found."""
    frames: int
    outliers: int
    rms_px: float
    """Reprojection error without outliers."""
    knot_ms: float
    """Spacing of the spline's knots."""
    seconds_followed: float
    left_out: dict[str, str]
    points: tuple[PathPoint, ...]


def follow(
    scene: Scene, instants: Sequence[int] | None, folder: Path, progress: Progress
) -> TrajectoryResult:
    """Find the largest moving object in each frame, fit its path, and write it as a table to a folder.

    A frame's time is the middle of its exposure in the object's row, if all cameras report what that needs;
    else the frame's time.

    Raises:
        BadInputError: no calibration can be found.
        NotApplicableError: nothing moves, too few frames show it, or the cameras see different things.
    """
    dataset, views, motion = scene.dataset, scene.views, scene.motion
    motion.require_several_images(views)
    chosen = dataset.chosen_instants(instants)
    times = ImageTimes(dataset, [*views])
    times_ms, projections, pixels, counted = list[float](), list[Array](), list[Array](), dict[str, int]()
    progress.total = len(views)
    for name, view in views.items():
        progress.step(name)
        there = [k for k in chosen if dataset.has_image(name, k)]
        images, total = (dataset.grey(name, k) for k in there), len(dataset.instants(name))
        middles = find_moving_points(images, motion.background(name), total)
        for k, point in zip(there, middles, strict=True):
            if point is None:
                continue
            times_ms.append(float(times.of_rows_ms(name, k, point[1:])[0]))
            projections.append(view.projection)
            pixels.append(view.undistort(point[None])[0])
            counted[name] = counted.get(name, 0) + 1
    if len(counted) < 2 or len(times_ms) < MIN_FRAMES:
        raise NotApplicableError(
            f"one moving object is seen in {len(times_ms)} frames of {len(counted)} cameras;"
            f" two cameras and {MIN_FRAMES} frames are needed",
            hint="take a burst in which it crosses still cameras' views, by three times its width or more",
        )
    order = np.argsort(times_ms, kind="stable")
    at_ms = np.array(times_ms)[order]
    moments = np.concatenate([[0], np.cumsum(np.diff(at_ms) > TOGETHER_MS)])
    rays = Rays((at_ms - at_ms[0]) / 1e3, np.array(projections)[order], np.array(pixels)[order])
    path, sd_px = choose_path(rays, moments)
    odd = path.residuals_px(rays) > OUTLIER * sd_px
    max_sd_px = REFUSED_PX * max(size_above_features(view.width, view.height) for view in views.values())
    if odd.mean() > MAX_OUTLIERS or sd_px > max_sd_px:
        raise NotApplicableError(
            f"{odd.sum()} of {len(odd)} frames do not fit one path at all, the others by {sd_px:.1f} px:"
            " the cameras see different things move, or one too fast for their rate",
            hint="leave one moving object in view, or choose --instants in which there is one",
        )
    seen_s = np.array([rays.times_s[moments == number].mean() for number in range(int(moments[-1]) + 1)])
    places, bars = path.at(seen_s), SIGMAS_95 * sd_px * path.sd_at(seen_s)
    first_ns = dataset.instants_ns[0] + round(at_ms[0] * 1e6)
    points = tuple(
        PathPoint(first_ns + round(s * 1e9), (float(x), float(y), float(z)), float(bar))
        for s, (x, y, z), bar in zip(seen_s, places, bars, strict=True)
    )
    lines = ["time_s,x,y,z,uncertainty"]
    lines += [
        f"{(point.leader_ns - points[0].leader_ns) / 1e9:.9f},"
        + ",".join(f"{value:.6g}" for value in (*point.position, point.uncertainty))
        for point in points
    ]
    write_atomic(folder / TABLE, ("\n".join(lines) + "\n").encode())
    residuals_px = path.residuals_px(rays.choose(~odd))
    return TrajectoryResult(
        session=dataset.name,
        unit=scene.unit,
        cameras=counted,
        frames=len(odd),
        outliers=int(odd.sum()),
        rms_px=round(float(np.sqrt((residuals_px**2).mean())), 4),
        knot_ms=round(path.knot_s * 1e3, 3),
        seconds_followed=round(float(seen_s[-1] - seen_s[0]), 6),
        left_out={name: "the object is in none of its frames" for name in views if name not in counted},
        points=points,
    )
