"""Whether two cameras can be rectified: their baseline, and how large pictures get on their common plane."""

import numpy as np

from reconstruction.common.geometry import Array, View, angle_deg, other_from_reference

MIN_BASELINE = 1e-6
"""Least distance of two cameras, in the calibration's unit and as a share of their distance from its origin.

Cameras that are closer stand at one place: what is left are rounding errors."""
MAX_CANVAS_SHARE = 8.0
"""Largest canvas in pictures of the reference: cameras that look some 60 degrees off their common plane."""
LEAST_AHEAD = 0.05
"""A ray whose cosine to the plane's normal is less runs along the plane, and meets it nowhere near."""


def baseline(reference: View, other: View) -> float:
    """The distance of two cameras in the calibration's unit.

    Raises:
        ValueError: it is none; the message gives it.
    """
    length = float(np.linalg.norm(other.centre - reference.centre))
    far = max(float(np.linalg.norm(reference.centre)), float(np.linalg.norm(other.centre)), 1.0)
    # The other way round NaN would pass.
    if not length > MIN_BASELINE * far:
        raise ValueError(f"both cameras stand at the same place by the calibration (baseline {length:.2g})")
    return length


def rectifying_rotations(reference: View, other: View) -> tuple[Array, Array, float, bool]:
    """The rotations of both views onto a common plane, the baseline's length, and whether to mirror.

    The common x axis is the baseline, kept as close to the reference's x (or y) axis as it can be, so
    that pictures stay upright; z is as close as possible to both viewing directions.

    Raises:
        ValueError: the two cameras stand at the same place, or one looks along the baseline.
    """
    length = baseline(reference, other)
    rotation, translation = other_from_reference(reference, other)
    x = -rotation.T @ translation / length
    lead = int(np.argmax(np.abs(x[:2])))
    mirror = bool(x[lead] < 0)
    if mirror:
        x = -x
    z = np.array([0.0, 0.0, 1.0]) + rotation.T @ np.array([0.0, 0.0, 1.0])
    z -= (z @ x) * x
    if np.linalg.norm(z) < 0.2:
        raise ValueError(f"the cameras stand one behind the other (baseline {length:.3g})")
    z /= np.linalg.norm(z)
    reference_rotation = np.stack([x, np.cross(z, x), z])
    return reference_rotation, reference_rotation @ rotation.T, length, mirror


def canvas_bounds(reference: View, other: View) -> tuple[Array, Array]:
    """Least and greatest x and y of the reference's picture on the common plane, px from its middle.

    Not mirrored, and at the reference's own resolution.

    Raises:
        ValueError: the pair cannot be rectified, or its canvas would be too large; the message has sizes.
    """
    turn, _, length, _ = rectifying_rotations(reference, other)
    rays = reference.rays(reference.border()) @ turn.T
    aside = (
        f"baseline {length:.3g}, viewing directions {angle_deg(reference.axis, other.axis):.0f} degrees apart"
    )
    ahead = rays[:, 2] / np.linalg.norm(rays, axis=1)
    if not ahead.min() > LEAST_AHEAD:
        raise ValueError(
            f"their pictures have no common plane: it would take a canvas without bounds ({aside})"
        )
    flat = rays[:, :2] / rays[:, 2:] * reference.focal
    low, high = flat.min(0), flat.max(0)
    wide, tall = high - low
    if wide * tall > MAX_CANVAS_SHARE * reference.width * reference.height:
        raise ValueError(
            f"rectified, a picture of {reference.width}x{reference.height} pixels would become "
            f"{wide:.0f}x{tall:.0f} ({aside})"
        )
    return low, high
