"""The order of cameras along their arc, where their poses are known; else by name."""

from typing import TYPE_CHECKING

from capture_app.names import natural_order
from capture_app.session.reading.reader import Session

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

PARALLEL = 1e-3
"""Of optical axes: the least mean squared sine of the angle between them and any one direction."""


def arc_order(session: Session) -> tuple[str, ...]:
    """Cameras as one passes them going round what they look at, from the end of the arc; else by name.

    Raises BadInputError where the session's calibration is broken.
    """
    names = sorted((camera.name for camera in session.manifest.cameras), key=natural_order)
    calibration = session.calibration()
    if calibration is None or len(names) < 3 or not all(name in calibration.cameras for name in names):
        return tuple(names)
    import numpy as np  # heavy: only where there are poses

    poses = [calibration.cameras[name] for name in names]
    rotations = np.array([pose.rotation for pose in poses])
    centres = -np.einsum("nij,ni->nj", rotations, np.array([pose.translation for pose in poses]))
    angles = _angles(centres, rotations[:, 2])
    order = np.argsort(angles)
    # The arc begins after its widest gap.
    gaps = np.diff(np.r_[angles[order], angles[order[0]] + 2 * np.pi])
    order = np.roll(order, -int(gaps.argmax()) - 1)
    found = tuple(names[index] for index in order)
    # Of the two directions the one that begins with the earlier name.
    return found if natural_order(found[0]) <= natural_order(found[-1]) else found[::-1]


def _angles(centres: "NDArray[np.float64]", directions: "NDArray[np.float64]") -> "NDArray[np.float64]":
    """Angles of the cameras around the point they look at, in the plane in which they stand and look.

    The point is the one nearest to all optical axes; for parallel ones it lies far ahead.
    """
    import numpy as np

    middle = centres.mean(axis=0)
    beside = np.eye(3) - directions[:, :, None] * directions[:, None]
    system = beside.mean(axis=0)
    if np.linalg.eigvalsh(system)[0] > PARALLEL:
        target = np.linalg.solve(system, np.einsum("nij,nj->ni", beside, centres).mean(axis=0))
    else:
        target = middle + 1000 * np.abs(centres - middle).max() * directions.mean(axis=0)
    from_target = centres - target
    _, _, axes = np.linalg.svd(np.r_[from_target, centres - middle], full_matrices=False)
    return np.asarray(np.arctan2(from_target @ axes[1], from_target @ axes[0]), np.float64)
