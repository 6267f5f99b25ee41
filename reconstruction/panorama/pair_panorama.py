"""A panorama of two registered cameras: blended, and judged where they overlap."""

from collections.abc import Sequence

import cv2
import numpy as np

from reconstruction.common.brightness import gain_and_bias
from reconstruction.common.geometry import Array
from reconstruction.panorama.optical_flow import dense_flow
from reconstruction.panorama.pair_registration import PairRegistration
from reconstruction.scores.tally import Measurements
from reconstruction.session.mover_detection import dilate


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
