"""What a camera of libcamera is: first as it is configured, then as its first frames show."""

from collections.abc import Sequence
from itertools import pairwise
from statistics import median
from typing import Any

from msgspec.structs import replace

from capture_app.camera_facts import CameraFacts, PhaseControl, StampAccuracy, StampSource, TimestampSource
from capture_app.cameras.libcamera.mode import Wishes
from capture_app.cameras.v4l2.layout import PixelFormat

KIND = "libcamera"
READOUT_DOUBT_ROWS, READOUT_DOUBT_NS = 16, 100_000
"""Assumed: rows that a sensor sends before the picture's first, and the stamp's way to the kernel."""
_USUAL_RATE, _ROUND_NS = 3e-4, 10_000


def facts_as_configured(
    camera: Any, layout: PixelFormat, wishes: Wishes, limits_us: tuple[int, int] | None
) -> CameraFacts:
    """What is known of a camera before its first frame; `limits_us` are those of a frame's duration."""
    properties = {control.name: value for control, value in camera.properties.items()}
    return CameraFacts(
        kind=KIND,
        model=str(properties.get("Model", camera.id)),
        width=layout.width,
        height=layout.height,
        pixel_format=layout.fourcc,
        period_ns=wishes.period_us * 1000,
        timestamp_source=TimestampSource.START_OF_EXPOSURE,
        phase_control=PhaseControl.RESET,
        exposure_ns=None if wishes.exposure_us is None else wishes.exposure_us * 1000,
        min_frame_duration_ns=None if limits_us is None else limits_us[0] * 1000,
        max_frame_duration_ns=None if limits_us is None else limits_us[1] * 1000,
    )


def with_rows(facts: CameraFacts, rows: int, row_us: float) -> CameraFacts:
    """The facts of a camera whose frames last so many rows, and whose rows are known."""
    row_ns = round(row_us * 1000)
    return replace(
        facts, period_ns=rows * row_ns, row_time_ns=row_ns, phase_control=PhaseControl.FRAME_DURATION
    )


def with_exposure(facts: CameraFacts, exposure_us: int, *, is_raspberry_pi: bool) -> CameraFacts:
    """The facts of a camera whose exposure is held, and whose stamps are late by it where that is known.

    The Raspberry Pi's driver stamps the first row on its way from the sensor: its exposure is over then,
    though libcamera calls that the time at which it was exposed.
    """
    exposure_ns, row_ns = exposure_us * 1000, facts.row_time_ns
    if row_ns is None:
        return replace(facts, exposure_ns=exposure_ns)
    exposure_ns = round(exposure_ns / row_ns) * row_ns
    late = StampAccuracy(
        bias_ns=exposure_ns,
        uncertainty_ns=READOUT_DOUBT_ROWS * row_ns + READOUT_DOUBT_NS,
        source=StampSource.PROFILE,
        exposure_ns=exposure_ns,
    )
    return replace(facts, exposure_ns=exposure_ns, stamp=late if is_raspberry_pi else None)


def with_period_of(facts: CameraFacts, stamps_ns: Sequence[int]) -> CameraFacts:
    """The facts of a camera whose frames had these stamps."""
    return replace(facts, period_ns=usual_period_ns(median(b - a for a, b in pairwise(stamps_ns))))


def usual_period_ns(measured_ns: float) -> int:
    """The frame period in ns that a camera means which runs about so: a whole rate's, or television's."""
    rate = 1e9 / measured_ns
    whole = max(1, round(rate))
    usual = min((whole, whole / 1.001), key=lambda one: abs(one - rate))
    if abs(usual / rate - 1.0) < _USUAL_RATE:
        return round(1e9 / usual)
    return round(measured_ns / _ROUND_NS) * _ROUND_NS
