"""A ball's path by four calibrated cameras at 30 frames a second: in step, and staggered (120 in all).

The ball is drawn (a disc with the blur of its motion during the exposure, a noisy background), found by the
centroid of what differs from the background, and its path is fitted to the rays of all frames: a uniform
cubic spline. Each order gets the spacing of knots that suits it best by the truth, so that neither suffers
from that choice. Geometry is exact; the frames' times have the error of a rig (`--error-us`). Simulated.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.report import Columns, Report, new_parser, print_report, print_rows
from reconstruction.methods.trajectory.spline_path import basis

Floats = NDArray[np.float64]
Motion = Callable[[Floats], Floats]
"""Position (n, 3) in m at times (n,) in s."""
CAMERAS, FPS, EXPOSURE_S = 4, 30.0, 0.002
SIZE, FOCAL_PX, AWAY_M, RADIUS_M = (640, 480), 600.0, 2.5, 0.035
GREY, NOISE, BLURRED = 40.0, 4.0, 9
"""Brightness of the background, standard deviation of its noise, and drawings averaged over the exposure."""
SECONDS, MARGIN_S = 1.6, 0.1
"""Length of a take, and the time at its ends that is not judged."""
KNOTS_S = (0.2, 0.13, 0.09, 0.06, 0.045, 0.034, 0.026, 0.02, 0.016)
SUB, WINDOW = 16, 64
"""Fraction of a pixel in which discs are drawn, and size in pixels of the drawn part around the ball."""
COLUMNS: Columns = {
    "motion": ("motion", ""),
    "step_mm": ("in step mm", ".1f"),
    "stagger_mm": ("staggered mm", ".1f"),
    "step_max_mm": ("worst", ".0f"),
    "stagger_max_mm": ("worst", ".0f"),
    "step_knots_ms": ("knots ms", ".0f"),
    "stagger_knots_ms": ("knots ms", ".0f"),
}


def thrown(t: Floats) -> Floats:
    """A ball thrown in an arc."""
    return np.stack([-0.9 + 1.1 * t, 0.35 - 3.4 * t + 4.905 * t**2 * 0.45, 0.2 * t], axis=1)


def bouncing(t: Floats) -> Floats:
    """A hard ball that bounces three times a second or so, and turns aside at each bounce."""
    lasting_s = 0.31
    bounce, since = np.floor(t / lasting_s), np.mod(t, lasting_s)
    height = 4.905 * since * (lasting_s - since)
    side = np.where(bounce % 2 == 0, 1.0, -1.0)
    return np.stack([side * (since - lasting_s / 2) * 1.6, 0.3 - height, 0.3 * side * since], axis=1)


def shaken(hertz: float) -> Motion:
    """A ball that is shaken on an ellipse of 10 cm."""

    def motion(t: Floats) -> Floats:
        angle = 2 * np.pi * hertz * t
        return np.stack([0.05 * np.cos(angle), 0.03 * np.sin(angle), 0.05 * np.sin(angle + 0.4)], axis=1)

    return motion


MOTIONS: dict[str, Motion] = {
    "thrown in an arc": thrown,
    "bouncing": bouncing,
    **{f"shaken, {hertz} Hz": shaken(hertz) for hertz in (2, 5, 8, 11, 14, 18, 25)},
}


@dataclass(frozen=True)
class Seen:
    """Rays of a take's frames: their times as recorded (s), 3 x 4 projections, and pixels."""

    times_s: Floats
    projections: Floats
    pixels: Floats


def projections() -> Floats:
    """Return the cameras' 3 x 4 matrices: a quarter of a circle around the origin, which they look at."""
    lens = np.array([[FOCAL_PX, 0, SIZE[0] / 2], [0, FOCAL_PX, SIZE[1] / 2], [0, 0, 1]])
    made = []
    for angle in np.linspace(-0.7, 0.7, CAMERAS):
        cos, sin = np.cos(angle), np.sin(angle)
        turned = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
        made.append(lens @ np.column_stack([turned, [0, 0, AWAY_M]]))
    return np.array(made)


def project(projection: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return the pixels (n, 2) of points (n, 3), and their depths (n,)."""
    seen = np.column_stack([points, np.ones(len(points))]) @ projection.T
    return seen[:, :2] / seen[:, 2:], seen[:, 2]


def find_ball(projection: Floats, motion: Motion, at_s: float, rng: np.random.Generator) -> Floats | None:
    """Draw a frame whose exposure has this middle, and return the centroid of the ball in it."""
    moments = at_s + EXPOSURE_S * (np.arange(BLURRED) / (BLURRED - 1) - 0.5)
    centres, depths = project(projection, motion(moments))
    corner = np.round(centres.mean(0)) - WINDOW // 2
    if not ((corner >= 0) & (corner + WINDOW <= SIZE)).all():
        return None
    image = np.zeros((WINDOW, WINDOW))
    for (x, y), depth in zip(centres - corner, depths, strict=True):
        drawn = np.zeros((WINDOW, WINDOW), np.uint8)
        centre, radius = (round(x * SUB), round(y * SUB)), round(FOCAL_PX * RADIUS_M / depth * SUB)
        cv2.circle(drawn, centre, radius, 160, -1, cv2.LINE_AA, 4)
        image += drawn / BLURRED
    taken = np.clip(np.round(image + GREY + rng.normal(0, NOISE, image.shape)), 0, 255)
    ball = np.where(taken - GREY > 6 * NOISE, taken - GREY, 0.0)
    rows, columns = np.indices(ball.shape)
    return np.asarray(corner + np.array([(columns * ball).sum(), (rows * ball).sum()]) / ball.sum())


def take(motion: Motion, *, staggered: bool, error_s: float, seed: int) -> Seen:
    """Return what four cameras see of a motion."""
    rng, cameras = np.random.default_rng(seed), projections()
    times, which, pixels = [], [], []
    for number in range(round(SECONDS * FPS)):
        for place, projection in enumerate(cameras):
            at_s = (number + (place / CAMERAS if staggered else 0.0)) / FPS
            if (found := find_ball(projection, motion, at_s, rng)) is not None:
                times.append(at_s + rng.normal(0, error_s))
                which.append(projection)
                pixels.append(found)
    return Seen(np.array(times), np.array(which), np.array(pixels))


def spline_values(times_s: Floats, knot_s: float) -> Floats:
    """Return the values (n, m) of the uniform cubic B-splines with these knots that cover a take."""
    return basis(times_s, -0.05, knot_s, int(np.ceil((SECONDS + 0.1) / knot_s)) + 4)


def fit_path(seen: Seen, knot_s: float) -> Floats:
    """Return the control points (m, 3) whose spline fits all rays best, in pixels: linear, reweighted."""
    values = spline_values(seen.times_s, knot_s)
    depth = np.full(len(values), AWAY_M)
    # As little as is needed where no frame determines a control point.
    bend = np.diff(np.eye(values.shape[1]), 2, axis=0) * 1e-2
    bends = np.kron(bend.T @ bend, np.eye(3))
    for _ in range(3):
        rows = []
        for axis in (0, 1):
            of = seen.projections[:, axis] - seen.pixels[:, axis, None] * seen.projections[:, 2]
            rows.append(of / depth[:, None])
        equations = np.concatenate(rows)
        twice = np.concatenate([values, values])
        left = (twice[:, :, None] * equations[:, None, :3]).reshape(len(equations), -1)
        control = np.linalg.solve(left.T @ left + bends, -left.T @ equations[:, 3]).reshape(-1, 3)
        points = np.column_stack([values @ control, np.ones(len(values))])
        depth = np.maximum((points * seen.projections[:, 2]).sum(1), 0.1)
    return np.asarray(control)


def path_errors_mm(
    motion: Motion, *, staggered: bool, error_s: float, seed: int
) -> tuple[float, float, float]:
    """Return the rms and the largest error of a path, mm, and the best spacing of its knots, ms."""
    seen, found = take(motion, staggered=staggered, error_s=error_s, seed=seed), []
    judged_s = np.arange(MARGIN_S, SECONDS - MARGIN_S, 0.001)
    for knot_s in KNOTS_S:
        path = spline_values(judged_s, knot_s) @ fit_path(seen, knot_s)
        apart = np.linalg.norm(path - motion(judged_s), axis=1) * 1000
        found.append((float(np.sqrt((apart**2).mean())), float(apart.max()), knot_s * 1000))
    return min(found)


def measure(motions: Sequence[str], seeds: int, error_us: float) -> Report:
    """Return a row of figures for each motion: means over the seeds, and the worst error of any."""
    rows: list[dict[str, Any]] = []
    for name in motions:
        row: dict[str, Any] = {"motion": name}
        for label, staggered in (("step", False), ("stagger", True)):
            errors = np.array(
                [
                    path_errors_mm(MOTIONS[name], staggered=staggered, error_s=error_us * 1e-6, seed=seed)
                    for seed in range(seeds)
                ]
            )
            row[f"{label}_mm"], row[f"{label}_knots_ms"] = errors[:, 0].mean(), errors[:, 2].mean()
            row[f"{label}_max_mm"] = errors[:, 1].max()
        rows.append(row)
    return {"kind": "simulated", "seeds": seeds, "error_us": error_us, "motions": rows}


def main() -> None:
    """Measure and print."""
    parser = new_parser(__doc__)
    parser.add_argument("--motion", action="append", choices=[*MOTIONS], help="only this motion; repeatable")
    parser.add_argument("--seeds", type=int, default=3, help="takes of each motion (3)")
    parser.add_argument("--error-us", type=float, default=20.0, help="sd of the frames' times, us (20)")
    options = parser.parse_args()
    report = measure(options.motion or [*MOTIONS], options.seeds, options.error_us)
    print_report(report, lambda found: print_rows(found["motions"], COLUMNS), as_json=options.json)


if __name__ == "__main__":
    main()
