"""Text for operators about the delay of cameras' timestamps."""

from collections.abc import Mapping

from capture_app.common.camera_facts import CameraFacts, StampAccuracy, StampSource, unshared_uncertainties_ns
from capture_app.common.text import count, duration

UNMEASURED = (StampSource.ASSUMED, StampSource.PROFILE)
REMEDY = "capture-app cameras calibrate-time"
"""Command that measures the timestamp delay."""
_SOURCES = {
    StampSource.CONSTRUCTION: "by construction",
    StampSource.DRIVER: "by its driver",
    StampSource.PROFILE: "by what is known of its kind",
    StampSource.MOTION: "measured by motion",
    StampSource.LIGHT: "measured by light",
    StampSource.ASSUMED: "assumed",
}


def describe_stamp(stamp: StampAccuracy) -> str:
    """Describe the delay of a camera's timestamps: 21 ms ±21 ms late, assumed."""
    if stamp.is_exact and not stamp.bias_ns:
        return f"exact, {_SOURCES[stamp.source]}"
    late = f"{duration(abs(stamp.bias_ns))} ±{duration(stamp.uncertainty_ns)}"
    against = f" against {stamp.against}, whose own bias is unknown" if stamp.against else ""
    return f"{late} {'late' if stamp.bias_ns >= 0 else 'early'}, {_SOURCES[stamp.source]}{against}"


def unmeasured_stamps(cameras: Mapping[str, CameraFacts]) -> str:
    """Name the cameras whose timestamp delay is not measured, or not against all others; empty for none.

    The text also names the command that measures it.
    """
    unsure = {
        name: camera.stamp_accuracy.uncertainty_ns
        for name, camera in cameras.items()
        if camera.stamp_accuracy.source in UNMEASURED
    }
    # Delays measured against different reference cameras are reported only if every camera has a measurement.
    against = {name: error_ns for name, error_ns in unshared_uncertainties_ns(cameras).items() if error_ns}
    unsure = unsure or against
    if not unsure:
        return ""
    worst = max(unsure, key=lambda name: unsure[name])
    others = f" and of {count(len(unsure) - 1, 'more camera')}" if len(unsure) > 1 else ""
    by_what = f" except against {cameras[worst].stamp_accuracy.against}" if unsure is against else ""
    return (
        f"stamp error of {worst}{others} not measured{by_what} (±{duration(unsure[worst])}):"
        f" {REMEDY} measures it"
    )
