"""When one camera saw moving points where another had seen them: crossings of epipolar lines.

A point that camera A shows at a time lies on its epipolar line in camera B at that same time only. B's
images show it before and after; where its path crosses the line, in B's own time, is when A's image was
taken. Motion along the line tells nothing.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np

from reconstruction.common.geometry import Array, View, other_from_reference


@dataclass(frozen=True)
class Crossings:
    """Crossings (n,) of epipolar lines, one for each pair of matched points.

    `instant` of A's image, `offset_ms`: how much later than its times say B's images were taken, against A's;
    `across_px_per_ms`: how fast the point crosses the line.
    """

    instant: Array
    offset_ms: Array
    across_px_per_ms: Array

    @classmethod
    def join(cls, parts: Iterable[Self]) -> Self:
        """All of them in one."""
        known = [(part.instant, part.offset_ms, part.across_px_per_ms) for part in parts]
        return cls(*(np.concatenate([np.zeros(0), *of]) for of in zip(*known, strict=True))) if known else (
            cls(np.zeros(0), np.zeros(0), np.zeros(0))
        )  # fmt: skip

    def later(self, by_ms: float) -> "Crossings":
        """The same, as if the second camera were later by so much."""
        return Crossings(self.instant, self.offset_ms + by_ms, self.across_px_per_ms)

    def only(self, chosen: Array) -> "Crossings":
        """Those that are chosen (bool)."""
        return Crossings(self.instant[chosen], self.offset_ms[chosen], self.across_px_per_ms[chosen])


@dataclass(frozen=True)
class Path:
    """Points in the image before, an image and the one after.

    `at` (3, n, 2) px, NaN where a point was not followed; `times_ms` (3, n).
    """

    at: Array
    times_ms: Array


def epipolar_errors_px(a: View, b: View, at_a: Array, at_b: Array) -> Array:
    """Signed distances (n,) of matched pixels (n, 2) from the epipolar geometry of two views, px.

    To first order (Sampson 1982; Hartley and Zisserman, 2nd edition, section 11.4.3). The views must not
    stand at one place.
    """
    rotation, translation = other_from_reference(a, b)
    x, y, z = translation / np.linalg.norm(translation)
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ rotation
    rays_a, rays_b = a.rays(at_a), b.rays(at_b)
    lines_b, lines_a = rays_a @ essential.T, rays_b @ essential
    steepness = np.sqrt((lines_b[:, :2] ** 2).sum(1) / b.focal**2 + (lines_a[:, :2] ** 2).sum(1) / a.focal**2)
    return np.asarray((rays_b * lines_b).sum(1) / np.maximum(steepness, 1e-12))


def find_crossings(
    views: tuple[View, View], instant: int, at_a: Array, times_a_ms: Array, path_b: Path
) -> Crossings:
    """The crossings of points (n, 2) px of A's image at `instant`, seen at `times_a_ms` (n,), by B's path.

    The distance from the line is a parabola through the three images of B, or a line through two; crossings
    outside them are left out.
    """
    before, now, after = (_errors(views, at_a, at) for at in path_b.at)
    early, late = (path_b.times_ms[i] - path_b.times_ms[1] for i in (0, 2))
    with np.errstate(invalid="ignore", divide="ignore"):
        slope_before, slope_after = (before - now) / early, (after - now) / late
        both = np.isfinite(slope_before) & np.isfinite(slope_after)
        bend = np.where(both, (slope_after - slope_before) / (late - early), 0.0)
        straight = np.where(np.isfinite(slope_before), slope_before, slope_after)
        slope = np.where(both, slope_before - bend * early, straight)
        root = np.sqrt(slope**2 - 4 * bend * now)
        when = -2 * now / (slope + np.copysign(root, slope))
        first = np.where(np.isfinite(slope_before), early, -0.2 * late)
        last = np.where(np.isfinite(slope_after), late, -0.2 * early)
        inside = (when >= first) & (when <= last)
    found = Crossings(
        np.full(len(at_a), instant),
        times_a_ms - (path_b.times_ms[1] + when),
        slope + 2 * bend * when,
    )
    return found.only(inside & np.isfinite(found.offset_ms))


def _errors(views: tuple[View, View], at_a: Array, at_b: Array) -> Array:
    known = np.isfinite(at_b).all(1)
    errors = np.full(len(at_b), np.nan)
    if known.any():
        errors[known] = epipolar_errors_px(*views, at_a[known], at_b[known])
    return errors
