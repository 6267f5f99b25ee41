"""Sound in exported MP4s: on the rig's time at both ends, from a clock that is off."""

from pathlib import Path

import pytest

from capture_app.companions.exporting.export_session import export_session
from tests.unit.plugins.programs.clicks import clicks_of
from tests.unit.plugins.programs.test_mp4_sound import CLICKS, takes
from tests.unit.plugins.programs.test_videos import frames


@pytest.mark.parametrize(("length_s", "ppm"), [(120, 500), (600, 100)])
def test_sound_is_in_step_at_both_ends(length_s: int, ppm: float, tmp_path: Path) -> None:
    session, given = takes(tmp_path, length_s, ppm)
    said: list[str] = []
    burst = export_session(session, "mp4", tmp_path / "out", on_warning=said.append, sound=given)
    export_session(session, "mp4", tmp_path / "silent")
    # Uncorrected, the last click would be 60 ms off.
    first_s = (min(one.leader_ns for one in session.manifest.images) - burst.origin_ns) / 1e9
    expected_s = [first_s + fraction * length_s for fraction in CLICKS]
    assert clicks_of(tmp_path / "out" / "late.mp4") == pytest.approx(expected_s, abs=0.005)
    # The pictures stay where they are without sound.
    with_sound, without = (frames(tmp_path / of / "late.mp4") for of in ("out", "silent"))
    assert with_sound == without
    assert any("early" in line and "no sound" in line for line in said)
