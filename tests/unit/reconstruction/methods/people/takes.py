"""Takes of drawn figures, for tests of people."""

from collections.abc import Sequence

import numpy as np

from benchmarks.people.figure import Floats, Motion, ring, seen_by
from reconstruction.methods.people.people_run import CameraFrames, PeopleFinder
from reconstruction.methods.people.skeletons import SKELETONS

STEP_S = 1 / 60
TIMES_S = np.arange(0, 1.0, STEP_S)


def take(
    motions: Sequence[Motion],
    cameras: int = 4,
    *,
    late: Sequence[float] = (),
    noise_px: float = 3.0,
    times_s: Floats = TIMES_S,
) -> dict[str, CameraFrames]:
    """Return what cameras see of figures; each camera's frames are `late` (frames) after the first's."""
    rng = np.random.default_rng(5)
    return {
        f"cam{k}": seen_by(view, motions, times_s + STEP_S * (late[k] if late else 0), rng, noise_px=noise_px)
        for k, view in enumerate(ring(cameras, 150))
    }


def finder(frames: dict[str, CameraFrames]) -> PeopleFinder:
    """Return the people of a take, matched."""
    return PeopleFinder(frames, SKELETONS["blazepose"], STEP_S)


def errors_mm(positions: Floats, motion: Motion, times: Floats) -> Floats:
    """Return the distances (times, joints) from the truth, mm."""
    return np.asarray(np.linalg.norm(positions - motion(times), axis=2) * 1e3)
