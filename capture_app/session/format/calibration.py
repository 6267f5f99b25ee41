"""The calibration of a rig, `calibration.json`: intrinsics and `cam_from_rig` of each camera."""

from msgspec import Struct

Vector3 = tuple[float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
"""Units of length and how many metres they are."""


class CameraCalibration(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Pinhole with OpenCV's distortion (k1, k2, p1, p2, k3); the first pixel's centre is (0, 0).

    `rotation` and `translation` (in the calibration's unit) are `cam_from_rig`: x_cam = R x_rig + t,
    x right, y down, z forward.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    rotation: Matrix3
    translation: Vector3
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)


class Calibration(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Cameras by name; `unit` is the unit of every translation, `source` says where it came from."""

    cameras: dict[str, CameraCalibration]
    unit: str = "m"
    source: str = ""
    schema_version: int = 1

    @property
    def source_words(self) -> str:
        """Where it came from, for people: one that does not say is the session's own."""
        return self.source or "the session's own"
