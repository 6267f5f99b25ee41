"""The calibration of a rig, `calibration.json`: intrinsics and `cam_from_rig` of each camera."""

import math
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta, Struct

from capture_app.common.bounds import Pixels, Real
from capture_app.common.errors import BadInputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Vector3 = tuple[Real, Real, Real]
Matrix3 = tuple[Vector3, Vector3, Vector3]

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
"""Length of each unit, in metres."""
_AGAIN = "export the calibration again with its program, or make one: reconstruct calibrate SESSION"


class CameraCalibration(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Pinhole with OpenCV's distortion (k1, k2, p1, p2, k3); the first pixel's centre is (0, 0).

    `rotation` and `translation` (in the calibration's unit) are `cam_from_rig`: x_cam = R x_rig + t,
    x right, y down, z forward.
    """

    width: Pixels
    height: Pixels
    fx: Real
    fy: Real
    cx: Real
    cy: Real
    rotation: Matrix3
    translation: Vector3
    distortion: Annotated[tuple[Real, ...], Meta(max_length=20)] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def matrix(self, width: int, height: int) -> "NDArray[np.float64]":
        """Return the camera matrix (3 x 3), scaled to images of `width` x `height` px."""
        import numpy as np  # slow to import, and this module is in every command's way

        sx, sy = width / self.width, height / self.height
        # What scales are the pixels' edges, half a pixel from their centres.
        cx, cy = (self.cx + 0.5) * sx - 0.5, (self.cy + 0.5) * sy - 0.5
        return np.array([[self.fx * sx, 0.0, cx], [0.0, self.fy * sy, cy], [0.0, 0.0, 1.0]])


def check_lens(where: str, camera: CameraCalibration) -> None:
    """Raise BadInputError, its message beginning with `where`, for parameters that no lens can have."""
    import numpy as np  # slow to import, and this module is in every command's way

    rotation, distortion = np.array(camera.rotation), camera.distortion
    lens = (camera.fx, camera.fy, camera.cx, camera.cy, *camera.translation, *distortion)
    if not all(map(math.isfinite, lens)) or not np.isfinite(rotation).all():
        raise BadInputError(f"{where} has numbers that are not finite", hint=_AGAIN)
    if camera.fx <= 0 or camera.fy <= 0:
        raise BadInputError(f"{where} has no camera matrix with positive focal lengths", hint=_AGAIN)
    if abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3:
        raise BadInputError(f"{where} has a rotation matrix that is not orthonormal", hint=_AGAIN)
    if np.linalg.det(rotation) < 0:
        raise BadInputError(f"{where} has a rotation matrix with left-handed axes: it mirrors", hint=_AGAIN)
    if any(distortion[5:]):
        raise BadInputError(
            f"{where} has {len(distortion)} distortion coefficients; 5 are supported",
            hint="calibrate with k1, k2, p1, p2, k3",
        )


class Calibration(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Cameras by name; `unit` is the unit of every translation, `source` says where it came from."""

    cameras: dict[str, CameraCalibration]
    unit: str = "m"
    source: str = ""
    schema_version: int = 1

    @property
    def source_words(self) -> str:
        """Describe the calibration's source for people; without one, it is the session's own."""
        return self.source or "the session's own"
