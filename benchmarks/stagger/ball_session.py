"""The drawn ball's path by `reconstruct trajectory`: in step, in two steps, and staggered.

Whole images of four calibrated cameras at 30 a second, which see an empty view first. Errors are those of
the path's points; `inside` is how many are within their 95 % uncertainty. Simulated.
"""

import tempfile
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.report import Columns, Report, new_parser, print_report, print_rows
from benchmarks.stagger.ball_path import (
    BLURRED,
    EXPOSURE_S,
    FOCAL_PX,
    FPS,
    GREY,
    MARGIN_S,
    MOTIONS,
    NOISE,
    RADIUS_M,
    SECONDS,
    SIZE,
    SUB,
    Floats,
    Motion,
    project,
    projections,
)
from capture_app.common.camera_facts import SIMULATED, CameraFacts, PhaseControl, TimestampSource
from capture_app.common.errors import NotApplicableError
from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.format.manifest import BurstRecord, CameraRecord
from capture_app.session.writing.session_writer import SessionWriter
from reconstruction.method.interface import find_method

PHASES = {
    "in step": (0.0, 0.0, 0.0, 0.0),
    "two steps": (0.0, 0.5, 0.0, 0.5),
    "staggered": (0.0, 0.25, 0.5, 0.75),
}
"""Delay of each camera in periods, by the order's name."""
PERIOD_NS = round(1e9 / FPS)
EMPTY = 32
"""Instants before the ball is there."""
COLUMNS: Columns = {
    "motion": ("motion", ""),
    "order": ("order", ""),
    "rms_mm": ("rms mm", ".1f"),
    "max_mm": ("largest", ".0f"),
    "inside": ("inside %", ".0f"),
    "moments": ("moments", ""),
    "knot_ms": ("knots ms", ".0f"),
}


def draw(projection: Floats, motion: Motion | None, at_s: float, rng: np.random.Generator) -> bytes:
    """Return a frame whose exposure has this middle, as PNG; without a motion, of an empty view."""
    image = np.zeros((SIZE[1], SIZE[0]))
    moments = at_s + EXPOSURE_S * (np.arange(BLURRED) / (BLURRED - 1) - 0.5)
    seen = () if motion is None else zip(*project(projection, motion(moments)), strict=True)
    for (x, y), depth in seen:
        drawn = np.zeros(image.shape, np.uint8)
        centre, radius = (round(x * SUB), round(y * SUB)), round(FOCAL_PX * RADIUS_M / depth * SUB)
        cv2.circle(drawn, centre, radius, 160, -1, cv2.LINE_AA, 4)
        image += drawn / BLURRED
    taken = np.clip(np.round(image + GREY + rng.normal(0, NOISE, image.shape)), 0, 255).astype(np.uint8)
    return cv2.imencode(".png", taken, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()


def write_session(
    root: Path, motion: Motion, order: str, *, error_s: float, seed: int, empty: int = EMPTY
) -> Path:
    """Write a take of a motion and return its folder; times are off by `error_s` (one sigma).

    The ball is there from the instant `empty` on.
    """
    rng = np.random.default_rng(seed)
    writer = SessionWriter.create(root, f"{order.replace(' ', '-')}-{seed}")
    lens = np.array([[FOCAL_PX, 0, SIZE[0] / 2], [0, FOCAL_PX, SIZE[1] / 2], [0, 0, 1]])
    calibrations, cameras = {}, []
    instants = empty + round(SECONDS * FPS)
    facts = CameraFacts(
        kind=SIMULATED,
        model="drawn",
        width=SIZE[0],
        height=SIZE[1],
        period_ns=PERIOD_NS,
        timestamp_source=TimestampSource.START_OF_EXPOSURE,
        phase_control=PhaseControl.NONE,
    )
    for place, (projection, phase) in enumerate(zip(projections(), PHASES[order], strict=True)):
        name, delay_ns = f"cam{place}", round(phase * PERIOD_NS)
        pose = np.linalg.inv(lens) @ projection
        calibrations[name] = CameraCalibration(
            width=SIZE[0],
            height=SIZE[1],
            fx=FOCAL_PX,
            fy=FOCAL_PX,
            cx=SIZE[0] / 2,
            cy=SIZE[1] / 2,
            rotation=tuple(tuple(map(float, row[:3])) for row in pose),  # type: ignore[arg-type]
            translation=tuple(map(float, pose[:, 3])),  # type: ignore[arg-type]
        )
        cameras.append(CameraRecord(name=name, facts=facts, delay_ns=delay_ns))
        for k in range(instants):
            true_ns = k * PERIOD_NS + delay_ns
            off_ns = round(rng.normal(0, error_s * 1e9))
            writer.add_image(
                draw(projection, motion if k >= empty else None, true_ns / 1e9 - empty / FPS, rng),
                camera=name,
                instant=k,
                leader_ns=true_ns + off_ns,
                residual_ns=off_ns,
                suffix=".png",
            )
    writer.set_calibration(Calibration(cameras=calibrations, source="drawn"))
    burst = BurstRecord(instants_ns=tuple(k * PERIOD_NS for k in range(instants)), period_ns=PERIOD_NS)
    return writer.finish(cameras, burst, origin="simulated").folder


def path_errors(motion: Motion, order: str, error_s: float, seed: int) -> tuple[Floats, Floats, float]:
    """Return the errors and the uncertainties (n,) of a path's points, mm, and its spacing of knots, ms."""
    with tempfile.TemporaryDirectory() as folder:
        session = write_session(Path(folder), motion, order, error_s=error_s, seed=seed)
        result = find_method("trajectory").make([session], Path(folder, "path"))
    times_s = np.array([one.leader_ns for one in result.points]) / 1e9 - EMPTY * PERIOD_NS / 1e9
    judged = (times_s > MARGIN_S) & (times_s < SECONDS - MARGIN_S)
    places = np.array([one.position for one in result.points])
    bars_mm = np.array([one.uncertainty for one in result.points]) * 1e3
    errors_mm = np.linalg.norm(places - motion(times_s), axis=1) * 1e3
    return errors_mm[judged], bars_mm[judged], result.knot_ms


def measure(motions: Sequence[str], seeds: int, error_us: float) -> Report:
    """Return a row of figures for each motion and order."""
    rows: list[dict[str, Any]] = []
    for name in motions:
        for order in PHASES:
            try:
                found = [path_errors(MOTIONS[name], order, error_us * 1e-6, seed) for seed in range(seeds)]
            except NotApplicableError:
                rows.append({"motion": name, "order": order, **dict.fromkeys(islice(COLUMNS, 2, None))})
                continue
            errors_mm, bars_mm = (np.concatenate([one[k] for one in found]) for k in (0, 1))
            rows.append(
                {
                    "motion": name,
                    "order": order,
                    "rms_mm": float(np.sqrt((errors_mm**2).mean())),
                    "max_mm": float(errors_mm.max()),
                    "inside": 100 * float((errors_mm <= bars_mm).mean()),
                    "moments": len(errors_mm) // seeds,
                    "knot_ms": float(np.mean([one[2] for one in found])),
                }
            )
    return {"kind": "simulated", "seeds": seeds, "error_us": error_us, "paths": rows}


def main() -> None:
    """Measure and print."""
    parser = new_parser(__doc__)
    parser.add_argument("--motion", action="append", choices=[*MOTIONS], help="only this motion; repeatable")
    parser.add_argument("--seeds", type=int, default=1, help="takes of each motion (1)")
    parser.add_argument("--error-us", type=float, default=20.0, help="sd of the frames' times, us (20)")
    options = parser.parse_args()
    report = measure(options.motion or [*MOTIONS], options.seeds, options.error_us)
    print_report(report, lambda found: print_rows(found["paths"], COLUMNS), as_json=options.json)


if __name__ == "__main__":
    main()
