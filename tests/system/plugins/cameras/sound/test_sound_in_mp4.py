"""Sound that images carried, in exported MP4s: in step at both ends of ten minutes."""

import wave
from pathlib import Path

import pytest

from capture_app.companions.exporting.export_session import export_session
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.unit.plugins.cameras.sound.arrivals import BEGIN_NS
from tests.unit.plugins.cameras.sound.test_sound_in_mp4 import LENGTH_S, recorded
from tests.unit.plugins.programs.clicks import clicks_of


def errors_ms(session: Session, video: Path) -> dict[int, float]:
    """How late each whole second's click is in a video, by the second of the true time."""
    origin_s = session.manifest.burst.instants_ns[0] / 1e9
    at_s = [click_s + origin_s for click_s in clicks_of(video)]
    return {round(one_s): 1000 * (one_s - round(one_s)) for one_s in at_s}


def test_sound_is_in_step_at_both_ends_of_ten_minutes(tmp_path: Path) -> None:
    session = recorded(tmp_path / "sessions", LENGTH_S)
    assert verify(session) == []
    export_session(session, "mp4", tmp_path / "out", wav=True)
    errors = errors_ms(session, tmp_path / "out" / "a.mp4")
    # Nobody has the sound of the overrun, and the image after a dropped one carries only a second of it.
    lost = set(range(14, 612)) - errors.keys()
    assert lost == {round(BEGIN_NS / 1e9 + LENGTH_S / 2 + 0.7), 253}
    assert list(errors.values()) == pytest.approx([0.0] * len(errors), abs=5.0)
    with wave.open(str(tmp_path / "out" / "a.wav")) as file:
        assert (file.getframerate(), file.getnchannels()) == (48_000, 1)
        assert file.getnframes() == pytest.approx(LENGTH_S * 48_000, abs=2000)


def test_sound_goes_on_in_step_when_a_killed_node_is_back(tmp_path: Path) -> None:
    session = recorded(tmp_path / "sessions", 40.0, restarted_at_s=10.0)
    export_session(session, "mp4", tmp_path / "out")
    errors = errors_ms(session, tmp_path / "out" / "a.mp4")
    assert {14, 20, 26, 50} <= errors.keys()
    assert list(errors.values()) == pytest.approx([0.0] * len(errors), abs=5.0)
