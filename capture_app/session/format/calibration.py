"""The calibration of a rig, `calibration.json`: intrinsics and `cam_from_rig` of each camera."""

from typing import TYPE_CHECKING, Annotated, Literal

from msgspec import UNSET, Meta, Struct, UnsetType

from capture_app.common.bounds import Pixels, Real

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Vector3 = tuple[Real, Real, Real]
Matrix3 = tuple[Vector3, Vector3, Vector3]

TERMS = {False: ("k1", "k2", "p1", "p2", "k3"), True: ("k1", "k2", "k3", "k4")}
"""Distortion coefficients of a perspective lens and of a fisheye, in their order."""
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
"""Length of each unit, in metres."""


class CameraCalibration(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Camera matrix and distortion of one of OpenCV's models; the first pixel's centre is (0, 0).

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
    """k1, k2, p1, p2, k3 of a perspective lens; k1, k2, k3, k4 of a fisheye."""
    model: Literal["fisheye"] | UnsetType = UNSET
    """`fisheye`: OpenCV's equidistant model; without it the lens is perspective."""
    seen_deg: Real | UnsetType = UNSET
    """Angle off the optical axis of the outermost point that the lens was measured by; unset if unknown."""

    @property
    def is_fisheye(self) -> bool:
        """Whether the lens has the fisheye model."""
        return self.model == "fisheye"

    def matrix(self, width: int, height: int) -> "NDArray[np.float64]":
        """Return the camera matrix (3 x 3), scaled to images of `width` x `height` px."""
        import numpy as np  # slow to import, and this module is in every command's way

        sx, sy = width / self.width, height / self.height
        # What scales are the pixels' edges, half a pixel from their centres.
        cx, cy = (self.cx + 0.5) * sx - 0.5, (self.cy + 0.5) * sy - 0.5
        return np.array([[self.fx * sx, 0.0, cx], [0.0, self.fy * sy, cy], [0.0, 0.0, 1.0]])


GUESS = "a guess from these pictures alone"
LEVELS: dict[Literal["well", "roughly", "not"], str] = {
    "roughly": "focal lengths known roughly: ",
    "not": "focal lengths not known well enough: ",
    "well": "focal lengths ",
}
"""Beginning of the text of each level; files of earlier versions have these texts in `source` alone."""


class LensKnowledge(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How well the images from which a calibration was estimated determine its focal lengths."""

    level: Literal["well", "roughly", "not"] = "well"
    """Roughly: depth may be off by more than 2 %; not: depth is not a measurement."""
    why: str = ""
    """The 95 % error of the focal lengths, or why the images do not determine them."""
    is_guess: bool = False
    """Whether no focal length was known before, so that all rests on these images."""

    @property
    def is_doubtful(self) -> bool:
        """Whether the focal lengths rest on no more than points at rest."""
        return self.is_guess or self.level == "not"

    @property
    def text(self) -> str:
        """Describe the knowledge for people; empty if there is nothing to say."""
        guess = GUESS if self.is_guess else ""
        return ", ".join(filter(None, (guess, f"{LEVELS[self.level]}{self.why}" if self.why else "")))

    def doubt(self, *, rough: bool = False) -> str:
        """Return a description of focal lengths that no image confirms; empty if they are confirmed.

        `rough`: also of focal lengths that are known roughly.
        """
        return f"{LEVELS[self.level]}{self.why}" if self.level in ("not", rough and "roughly") else ""


class Calibration(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Cameras by name; `unit` is the unit of every translation, `source` says where it came from."""

    cameras: dict[str, CameraCalibration]
    unit: str = "m"
    source: str = ""
    lenses: LensKnowledge | UnsetType = UNSET
    """Unset if the calibration was not estimated from images here; see `known_lenses`."""
    schema_version: int = 1

    @property
    def source_words(self) -> str:
        """Describe the calibration's source for people; without one, it is the session's own."""
        return self.source or "the session's own"

    @property
    def known_lenses(self) -> LensKnowledge:
        """Return `lenses`; of a file of an earlier version, from its source."""
        if self.lenses:
            return self.lenses
        level, start = next(item for item in LEVELS.items() if item[1] in self.source or item[0] == "well")
        why = self.source.partition(start)[2].partition(";")[0]
        return LensKnowledge(level=level, why=why, is_guess=GUESS in self.source)
