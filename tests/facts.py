"""The facts of a camera, for tests that care about few of them."""

from typing import Any

from capture_app.common.camera_facts import CameraFacts, PhaseControl, TimestampSource

PLAIN: dict[str, Any] = {
    "kind": "sim",
    "model": "test",
    "width": 640,
    "height": 480,
    "period_ns": 33_333_333,
    "timestamp_source": TimestampSource.START_OF_EXPOSURE,
    "phase_control": PhaseControl.NONE,
}


def make_facts(**different: Any) -> CameraFacts:
    """A camera's facts, plain but for what is given."""
    return CameraFacts(**PLAIN | different)
