"""Offsets of cameras that move, with calibrations that are wrong: what is at rest moves before them, too."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from reconstruction.common.geometry import View
from reconstruction.time_offsets.crossings import Crossings, OffsetFit, Path, find_crossings, points_at_offset
from reconstruction.time_offsets.pair_offset import MovingMatches, fit_in_motion
from tests.unit.reconstruction.conftest import make_view

PERIOD_MS = 33.0
INSTANTS = range(8)
A, B = make_view((-0.2, 0, 0)), make_view((0.2, 0, 0))
FAULTS = {
    "turned": replace(B, rotation=cv2.Rodrigues(np.array([0.02, 0.01, -0.02]))[0] @ B.rotation),
    "moved": replace(B, translation=B.translation + np.array([0.0, 0.03, 0.06])),
}


def path(view: View, at_ms: float) -> Path:
    """A camera's path of points at rest, from a car that drives and sways."""
    rng, noise = np.random.default_rng(0), np.random.default_rng([round(at_ms) + 1000, view is B])
    z = rng.uniform(3, 12, 70)
    points = np.stack([rng.uniform(-0.4, 0.4, 70) * z, rng.uniform(-0.3, 0.3, 70) * z, z], axis=1)
    places, times_ms = [], at_ms + PERIOD_MS * np.arange(-1, 2)
    for time_ms in times_ms:
        t = time_ms / 1e3
        place = np.array([0.1 * np.sin(9 * t), 0.08 * np.sin(13 * t), 3 * t - 0.4])
        there = (points - place) @ view.rotation.T + view.translation
        places.append(view.project(there) + noise.normal(0, 0.1, (70, 2)))
    return np.stack(places), np.tile(times_ms[:, None], 70)


def measure(calibrated: View, late_ms: float) -> OffsetFit:
    """Measure how late the second camera is, with this calibration of it."""
    found: dict[tuple[int, int], tuple[Path, Path]] = {}
    for k in INSTANTS:
        for other in range(max(0, k - 2), min(len(INSTANTS), k + 3)):
            places, times_ms = path(B, PERIOD_MS * other + late_ms)
            found[k, other] = path(A, PERIOD_MS * k), (places, times_ms - late_ms)

    def cross(pair: tuple[View, View]) -> Crossings:
        ones, zeros = np.ones(70), np.zeros(70)
        return Crossings.join(find_crossings(pair, at, paths, ones, zeros) for at, paths in found.items())

    def in_motion(offset_ms: float) -> MovingMatches:
        near = round(-offset_ms / PERIOD_MS)
        parts = [points_at_offset(*found[k, k + near], offset_ms) for k in INSTANTS if (k, k + near) in found]
        at_a, at_b, speeds = (np.concatenate(of) for of in zip(*parts, strict=True))
        return at_a, at_b, speeds

    return fit_in_motion((A, calibrated), PERIOD_MS, cross, in_motion)


@pytest.mark.parametrize(("fault", "late_ms"), [("turned", 0.0), ("moved", -60.0)])
def test_delay_and_calibration_of_moving_cameras_are_fitted_together(fault: str, late_ms: float) -> None:
    """Before, the moving points agreed on no offset, or on -36.5 ± 7.6 ms instead of -60."""
    fit = measure(FAULTS[fault], late_ms)
    assert fit.offset_ms is not None, fit.reason
    assert fit.sd_ms is not None
    assert abs(fit.offset_ms - late_ms) < 2 * fit.sd_ms
    assert fit.sd_ms < 1.5


def test_a_delay_is_no_fault_of_the_calibration() -> None:
    """60 ms move the points by more than 0.6 px across their lines, as a wrong calibration does."""
    fit = measure(B, 60.0)
    assert fit.misfit_px is None
    assert fit.offset_ms == pytest.approx(60, abs=2)
