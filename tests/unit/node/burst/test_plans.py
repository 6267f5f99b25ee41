"""What is said of a finished burst."""

from capture_app.node.burst.plans import result_text
from capture_app.session.format.manifest import BurstRecord, MissingImage


def test_a_reason_that_cameras_share_is_said_once() -> None:
    reasons = {"a": "the burst was cancelled", "b": "the burst was cancelled", "c": "lost"}
    missing = [MissingImage(camera=name, instant=0, reason=reason) for name, reason in reasons.items()]
    said = result_text(BurstRecord(instants_ns=(0,), period_ns=1), missing, {"a": "left", "b": "b", "c": "c"})
    assert said == "3 images missing (c: lost; b, left: the burst was cancelled)"
