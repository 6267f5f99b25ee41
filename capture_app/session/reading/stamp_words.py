"""What is said of how late cameras' stamps are, to who looks at a rig or at a session."""

from collections.abc import Mapping

from capture_app.common.camera_facts import CameraFacts, StampAccuracy, StampSource, unshared_uncertainties_ns
from capture_app.common.text import count, duration

UNMEASURED = (StampSource.ASSUMED, StampSource.PROFILE)
REMEDY = "capture-app cameras calibrate-time"
"""What measures it."""
_SOURCES = {
    StampSource.CONSTRUCTION: "by construction",
    StampSource.DRIVER: "by its driver",
    StampSource.PROFILE: "by what is known of its kind",
    StampSource.MOTION: "measured by motion",
    StampSource.LIGHT: "measured by light",
    StampSource.ASSUMED: "assumed",
}


def describe_stamp(stamp: StampAccuracy) -> str:
    """Say how late a camera's stamps are: 21 ms ±21 ms late, assumed."""
    if stamp.is_exact and not stamp.bias_ns:
        return f"exact, {_SOURCES[stamp.source]}"
    late = f"{duration(abs(stamp.bias_ns))} ±{duration(stamp.uncertainty_ns)}"
    against = f" against {stamp.against}, of which nobody knows it" if stamp.against else ""
    return f"{late} {'late' if stamp.bias_ns >= 0 else 'early'}, {_SOURCES[stamp.source]}{against}"


def unmeasured_stamps(cameras: Mapping[str, CameraFacts]) -> str:
    """Say whose stamps nobody has measured, or not against all others', and what does; empty for nobody's."""
    unsure = {
        name: camera.stamp_accuracy.uncertainty_ns
        for name, camera in cameras.items()
        if camera.stamp_accuracy.source in UNMEASURED
    }
    # What was measured, though against other cameras than the rest, is left to be said where all were.
    against = {name: error_ns for name, error_ns in unshared_uncertainties_ns(cameras).items() if error_ns}
    unsure = unsure or against
    if not unsure:
        return ""
    worst = max(unsure, key=lambda name: unsure[name])
    others = f" and of {count(len(unsure) - 1, 'more camera')}" if len(unsure) > 1 else ""
    by_what = f" but against {cameras[worst].stamp_accuracy.against}" if unsure is against else ""
    return (
        f"how late the stamps of {worst}{others} are, to ±{duration(unsure[worst])},"
        f" nobody has measured{by_what}: {REMEDY} does"
    )
