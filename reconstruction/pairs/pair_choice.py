"""Which two cameras make the best depth, and which two the best panorama."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from reconstruction.common.geometry import View, angle_deg, angles_deg, other_from_reference
from reconstruction.pairs.features import CELLS, MIN_MATCHES, Features, grid_cells, match_features
from reconstruction.pairs.homography import fit_homography
from reconstruction.pairs.pair_geometry import canvas_bounds

OVERLAP_LIMITS = (0.15, 0.8)
"""Share of a picture that its neighbour in a panorama shows too."""
EPIPOLAR_PX = 3.0
BEST_PARALLAX_DEG = 10.0
"""Beyond this the two views look too different to match densely."""

MAX_TOLD = 3
"""Pairs whose reasons are told in a sentence."""


@dataclass(frozen=True)
class PairChoice:
    """A pair of cameras, or None, and the reason in words.

    `left_out`: by two names with a comma between, why those cameras can make no depth whatever they see.
    """

    cameras: tuple[str, str] | None
    why: str
    left_out: Mapping[str, str] = field(default_factory=dict)


def choose_stereo_pair(views: Mapping[str, View], points: Mapping[str, Features]) -> PairChoice:
    """The pair that sees most in common, with enough parallax and nearly parallel axes.

    Scored by the share of the picture with matched still points times a factor that rises with
    parallax (depth needs it) and falls beyond `BEST_PARALLAX_DEG` (matching suffers). Pairs that cannot
    be rectified are left out.
    """
    why = (
        f"no two cameras have {MIN_MATCHES} points in common that stand still: they look from too far apart,"
        " or what stands still has no texture"
    )
    best, choice = -np.inf, PairChoice(None, why)
    left_out = {}
    for a, b in combinations((name for name in points if name in views), 2):
        try:
            canvas_bounds(views[a], views[b])
        except ValueError as error:
            left_out[f"{a},{b}"] = str(error)
            continue
        scored = _stereo_score(views[a], views[b], points[a], points[b])
        if scored is not None and scored[0] > best:
            best, choice = scored[0], PairChoice((a, b), scored[1])
    if choice.cameras is None and left_out:
        choice = PairChoice(None, f"{choice.why}; {describe_left_out(left_out)}")
    return replace(choice, left_out=left_out)


def describe_left_out(left_out: Mapping[str, str]) -> str:
    """Why pairs are left out, in words; of many the first few."""
    told = [f"{pair}: {why}" for pair, why in list(left_out.items())[:MAX_TOLD]]
    more = [f"and {len(left_out) - MAX_TOLD} more pairs"] if len(left_out) > MAX_TOLD else []
    return "; ".join(told + more)


def _stereo_score(a: View, b: View, points_a: Features, points_b: Features) -> tuple[float, str] | None:
    at_a, at_b = match_features(points_a, points_b)
    if len(at_a) < MIN_MATCHES:
        return None
    rays_a, rays_b = a.rays(at_a), b.rays(at_b)
    rotation, translation = other_from_reference(a, b)
    normals = np.cross(translation, rays_a @ rotation.T)
    off = np.abs((rays_b * normals).sum(1)) / np.maximum(np.linalg.norm(normals[:, :2], axis=1), 1e-12)
    kept = off * b.focal < EPIPOLAR_PX
    if kept.sum() < MIN_MATCHES:
        return None
    parallax = float(np.median(angles_deg(rays_a[kept] @ rotation.T, rays_b[kept])))
    shared = len(grid_cells(at_a[kept], a.width, a.height)) / CELLS
    ahead = abs(float(a.axis @ (b.centre - a.centre))) / float(np.linalg.norm(b.centre - a.centre))
    angle = angle_deg(a.axis, b.axis)
    score = shared * (1 - np.exp(-parallax / 1.5)) * np.exp(-((parallax / BEST_PARALLAX_DEG) ** 2))
    step = np.abs(a.rotation @ (b.centre - a.centre))[:2]
    slant = float(step.min() / max(float(np.hypot(*step)), 1e-12))
    # A slanted baseline turns the pictures: more empty corners, and harder to look at.
    score *= (1 - ahead**2) * np.exp(-((angle / 25) ** 2)) * (1 - slant)
    why = f"{100 * shared:.0f} % of the picture with things both see, {parallax:.1f}° of parallax"
    return float(score), why


def choose_panorama_pair(points: Mapping[str, Features], sizes: Mapping[str, tuple[int, int]]) -> PairChoice:
    """The pair that shows most beyond each other and still overlaps, with little parallax.

    Scored by what the second adds to the first times the share of still points that one homography
    explains, which falls as the cameras stand further apart.
    """
    best, choice = -np.inf, PairChoice(None, "no two cameras' pictures can be laid over each other")
    overlaps = []
    for a, b in combinations(points, 2):
        found = fit_homography(*match_features(points[a], points[b]), sizes[a], sizes[b])
        if found is None:
            continue
        overlaps.append(found.overlap)
        if not OVERLAP_LIMITS[0] <= found.overlap <= OVERLAP_LIMITS[1]:
            continue
        score = (1 - found.overlap) * (found.inliers / found.matches)
        if score > best:
            best, choice = score, PairChoice((a, b), f"{100 * found.overlap:.0f} % overlap")
    if overlaps and choice.cameras is None:
        least = f"{100 * min(overlaps):.0f} % or more"
        why = f"the cameras show too much of the same ({least}) for a panorama to show anything new"
        return PairChoice(None, why)
    return choice
