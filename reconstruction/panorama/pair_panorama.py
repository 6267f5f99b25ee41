"""A panorama of two cameras: registered on one cylinder by what stands still, blended, and judged."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from reconstruction.common.brightness import gain_and_bias, match_brightness
from reconstruction.common.geometry import Array, View
from reconstruction.pairs.homography import Homography
from reconstruction.panorama.optical_flow import dense_flow
from reconstruction.scores.tally import Measurements
from reconstruction.session.mover_detection import dilate

MIN_SIDE_PX = 64
MAX_GROWTH = 4.0
"""A panorama larger than this many pictures is a failed registration."""
SMOOTHNESS = 0.06
"""How quickly the correction of parallax may change, as a share of the overlap's size."""


@dataclass(frozen=True)
class PairRegistration:
    """Where each panorama pixel looks in both pictures; fixed for all instants and conditions.

    `maps` are float32 (height, width, 2), px, one for each camera; `seen` are bool masks.
    """

    maps: tuple[Array, Array]
    seen: tuple[Array, Array]

    @property
    def overlap(self) -> Array:
        """Pixels that both cameras see, without the outermost ones (bool)."""
        both = (self.seen[0] & self.seen[1]).astype(np.uint8)
        inner = cv2.erode(both, np.ones((7, 7), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
        return np.asarray(inner > 0)

    def warp(self, image: Array, which: int, *, nearest: bool = False) -> Array:
        """An image of the first (0) or second (1) camera on the panorama."""
        how = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
        return np.asarray(cv2.remap(image, self.maps[which], None, how))


def uncalibrated_view(width: int, height: int) -> View:
    """A view guessed for an uncalibrated camera: no distortion, a field of view of about 60 degrees."""
    focal = 0.87 * max(width, height)
    matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    return View(width, height, matrix, np.zeros(5), np.eye(3), np.zeros(3))


def undistort_pixels(view: View, at: Array) -> Array:
    """Pixels (n, 2) with the lens's distortion taken out."""
    spread = view.rays(at)[:, :2]
    return np.asarray(spread * (view.matrix[0, 0], view.matrix[1, 1]) + view.matrix[:2, 2])


def register_pair(first: View, second: View, homography: Homography) -> PairRegistration:
    """Lay two pictures side by side on a cylinder, joined by a homography between their flat pixels.

    Raises:
        ValueError: the panorama would be too small or too large, or the pictures do not overlap.
    """
    edge = second.border()
    beyond = _apply(np.linalg.inv(homography.matrix), undistort_pixels(second, edge))
    rays = np.concatenate([first.rays(first.border()), _flat_rays(first, beyond)])
    yaw = np.arctan2(rays[:, 0], rays[:, 2])
    rise = rays[:, 1] / np.hypot(rays[:, 0], rays[:, 2])
    focal = first.focal
    width = int(np.ceil((yaw.max() - yaw.min()) * focal)) + 1
    height = int(np.ceil((rise.max() - rise.min()) * focal)) + 1
    area = first.width * first.height
    if min(width, height) < MIN_SIDE_PX or width * height > MAX_GROWTH * area:
        raise ValueError(f"the two pictures do not fit together (a panorama of {width}x{height} pixels)")
    xs, ys = np.meshgrid(np.arange(width), np.arange(height))
    angle = (xs / focal + yaw.min()).ravel()
    up = (ys / focal + rise.min()).ravel()
    looking = np.column_stack([np.sin(angle), up, np.cos(angle)])
    front = looking[:, 2] > 0.05
    looking[~front] = (0, 0, 1)
    plane = looking[:, :2] / looking[:, 2:] * (first.matrix[0, 0], first.matrix[1, 1]) + first.matrix[:2, 2]
    map_a, seen_a = _distorted(first, looking)
    at_b = _apply(homography.matrix, plane)
    map_b, seen_b = _distorted(second, _flat_rays(second, at_b))
    # The far side of the homography's horizon mirrors the picture.
    ahead = homography.matrix[2] @ np.column_stack([plane, np.ones(len(plane))]).T > 0
    shape = (height, width)
    result = PairRegistration(
        (map_a.reshape(*shape, 2), map_b.reshape(*shape, 2)),
        ((seen_a & front).reshape(shape), (seen_b & front & ahead).reshape(shape)),
    )
    if result.overlap.sum() < 0.05 * area:
        raise ValueError("the two pictures hardly overlap")
    return result


def correct_parallax(
    registration: PairRegistration, first: Array, second: Array, moving: Array
) -> PairRegistration:
    """Correct parallax: warp the second picture smoothly so that what stands still fits in the overlap.

    `first` and `second` are grey pictures of the still background on the panorama, `moving` masks what
    moves there at any time (bool). The correction fades out beyond the overlap.
    """
    overlap = registration.overlap
    good = (overlap & ~moving).astype(np.float32)
    if good.sum() < 1000:
        return registration
    matched = np.where(overlap, match_brightness(first, second.astype(np.float32)), first)
    flow = dense_flow(first, matched)
    reach = SMOOTHNESS * float(np.sqrt(overlap.sum()))
    weight = cv2.GaussianBlur(good, (0, 0), reach)
    bend = cv2.GaussianBlur(flow * good[..., None], (0, 0), reach) / np.maximum(weight, 1e-3)[..., None]
    # Panorama pixels to pixels of the second picture: the local scale of its map is about one.
    xs, ys = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in overlap.shape[::-1]))
    where = np.dstack([xs, ys]) + bend
    bent = cv2.remap(
        registration.maps[1],
        where.astype(np.float32),
        None,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    seen = cv2.remap(registration.seen[1].astype(np.uint8), where.astype(np.float32), None, cv2.INTER_NEAREST)
    return PairRegistration((registration.maps[0], bent), (registration.seen[0], seen > 0))


def blend_pair(registration: PairRegistration, first: Array, second: Array) -> Array:
    """The panorama of two BGR pictures (uint8), cross-faded over the overlap; black where neither reaches."""
    a, b = (registration.warp(image, i).astype(np.float32) for i, image in enumerate((first, second)))
    seen_a, seen_b = registration.seen
    overlap = registration.overlap
    for channel in range(3):
        matched = np.where(overlap, b[..., channel], np.nan).astype(np.float32)
        if overlap.sum() > 1000:
            gain = float(np.nanmedian(a[..., channel][overlap])) / max(float(np.nanmedian(matched)), 1.0)
            b[..., channel] *= np.clip(gain, 0.7, 1.4)
    far_a = cv2.distanceTransform(seen_a.astype(np.uint8), cv2.DIST_L2, 3)
    far_b = cv2.distanceTransform(seen_b.astype(np.uint8), cv2.DIST_L2, 3)
    share = (far_a / np.maximum(far_a + far_b, 1e-6))[..., None]
    blended = np.clip(a * share + b * (1 - share), 0, 255)
    return np.where((seen_a | seen_b)[..., None], blended, 0).astype(np.uint8)


def measure_misfit(
    registration: PairRegistration, first: Array, second: Array, moving: Array, still: Array
) -> Measurements:
    """Misfit of two grey pictures (uint8): `moving` and `still` are masks on the panorama (bool).

    Measures are those of `PanoramaScores`. Flow is dense optical flow (DIS) from one to the other, px; MAD is
    the mean absolute grey difference.
    """
    overlap = registration.overlap
    a = registration.warp(first, 0)
    # Brightness is matched on what stands still, so that movers cannot affect the control.
    matched = registration.warp(second, 1).astype(np.float32)
    gain, bias = gain_and_bias(a, np.where(overlap & still, matched, np.float32(np.nan)))
    b = np.asarray(gain * matched + bias, np.float32)
    difference = np.abs(a.astype(np.float32) - b)
    length = np.linalg.norm(dense_flow(a, np.where(overlap, b, a)), axis=2)
    on_movers, on_still = overlap & moving, overlap & still
    measured = {
        "overlap_flow_p95_px": float(np.percentile(length[overlap], 95)),
        "static_overlap_mad": float(difference[on_still].mean()) if on_still.any() else 0.0,
    }
    if on_movers.sum() >= 50:
        measured["mover_flow_p95_px"] = float(np.percentile(length[on_movers], 95))
        measured["mover_overlap_mad"] = float(difference[on_movers].mean())
    return Measurements(means={name: np.array([value]) for name, value in measured.items()})


def panorama_masks(
    registration: PairRegistration,
    moving: tuple[Array, Array],
    changing: tuple[Sequence[Array], Sequence[Array]],
) -> tuple[Array, Array]:
    """Moving and still pixels on the panorama (bool).

    `moving`: what moves in the first and the second picture that are measured. `changing`: for each
    camera the masks of what moves or changes in either condition, so that both are judged on the same pixels.
    """

    def onto(mask: Array, which: int) -> Array:
        return registration.warp(mask.astype(np.uint8), which, nearest=True) > 0

    moved = onto(moving[0], 0) | onto(moving[1], 1)
    changed = [onto(mask, which) for which in (0, 1) for mask in changing[which]]
    return moved, ~dilate(np.logical_or.reduce(changed), 6)


def _apply(matrix: Array, at: Array) -> Array:
    mapped = np.column_stack([at, np.ones(len(at))]) @ matrix.T
    depth = np.where(np.abs(mapped[:, 2:]) < 1e-9, 1e-9, mapped[:, 2:])
    return np.asarray(mapped[:, :2] / depth)


def _flat_rays(view: View, at: Array) -> Array:
    spread = (at - view.matrix[:2, 2]) / (view.matrix[0, 0], view.matrix[1, 1])
    return np.column_stack([spread, np.ones(len(at))])


def _distorted(view: View, rays: Array) -> tuple[Array, Array]:
    """Pixels (n, 2; float32) of directions, and whether they lie in the picture (bool)."""
    at = rays[:, :2] / rays[:, 2:]
    edge = np.abs(view.rays(view.border())[:, :2]).max(0) * 1.02
    # Beyond the picture's edge the distortion's polynomial may fold back into it.
    near = (np.abs(at) <= edge).all(1)
    safe = np.column_stack([np.where(near[:, None], at, 0), np.ones(len(at))])
    pixels = view.project(safe)
    inside = (pixels > -0.5).all(1) & (pixels < (view.width - 0.5, view.height - 0.5)).all(1)
    return np.where(near[:, None], pixels, -1e4).astype(np.float32), near & inside
