"""`capture-app panel read` on the bundled session and on an import that says nothing of its cameras."""

from collections.abc import Iterator
from functools import cache

import pytest

from capture_app.companions.panel import session_times
from capture_app.companions.panel.panel_delays import measure
from capture_app.session.reading.reader import Session
from tests.project import SAMPLES

BUNDLED = SAMPLES / "led_panel"


@pytest.fixture(scope="module", autouse=True)
def _each_session_is_read_once() -> Iterator[None]:
    """Share what is read off a session's pictures: it takes most of these tests' time."""
    read = session_times.read_session
    found = cache(lambda folder: read(Session.open(folder)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(session_times, "read_session", lambda session, *_: found(session.folder))
        yield


def test_a_panel_tells_how_late_a_camera_is_against_another() -> None:
    session = Session.open(BUNDLED)
    there = measure(session, "cam00")
    back = measure(session, "cam01")
    assert there.cameras.keys() == back.cameras.keys() == {"cam00", "cam01"}
    assert there.cameras["cam00"].offset_ms == back.cameras["cam01"].offset_ms == 0.0
    late_ms, early_ms = there.cameras["cam01"].offset_ms, back.cameras["cam00"].offset_ms
    # The figures of `panel read`: cam01 is 30 us earlier, of which the stamps tell 46.
    assert late_ms == pytest.approx(0.015, abs=0.002)
    assert early_ms == -late_ms
    assert there.cameras["cam01"].sd_ms == pytest.approx(0.01, abs=0.001)
