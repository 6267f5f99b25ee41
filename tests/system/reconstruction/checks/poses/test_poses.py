"""Poses of single instants: errors that no choice of world changes, and what is said of them."""

from capture_app.session.reading.reader import Session
from reconstruction.scene.conditions import DISTINCT, Condition
from tests.project import SAMPLES
from tests.unit.reconstruction.checks.poses.test_poses import compared, study

PINWHEEL = SAMPLES / "pinwheel"


def test_a_pinwheel_places_its_cameras_only_when_synchronized() -> None:
    found = compared(study(Session.open(PINWHEEL)), Condition(DISTINCT))
    assert found.value("registered") == 5
    assert found.value("correct_pairs") == 1
    turned_by = found.value("rotation_deg")
    assert turned_by is not None
    assert turned_by < 0.5
    assert found.facts.degraded
    assert found.value("correct_pairs", "offset") == 0
    turned_by = found.value("rotation_deg", "offset")
    assert turned_by is None or turned_by > 10
