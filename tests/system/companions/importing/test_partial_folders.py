"""Folders of which a part can be used: a mute clip, a later clip, chapters; and what is no recording."""

from dataclasses import replace
from pathlib import Path

import pytest

from tests.unit.companions.importing.strangers import CLAPS, A, B
from tests.unit.companions.importing.test_partial_folders import imported


@pytest.mark.parametrize("mute", ["a", "c"])
def test_a_mute_clip_does_not_cost_the_others_their_alignment(
    tmp_path: Path, mute: str, capsys: pytest.CaptureFixture[str]
) -> None:
    names = [name for name in "abc" if name != mute]
    for name, phone in zip(names, (A, B), strict=True):
        replace(phone, fps=15).record(CLAPS, tmp_path / "in" / f"{name}.mp4", 6)
    replace(A, fps=15, seed=9).record(CLAPS, tmp_path / "in" / f"{mute}.mp4", 6, sound=False)
    session = imported(tmp_path / "in")
    assert [camera.name for camera in session.manifest.cameras] == names
    times = session.manifest.burst.common_times
    assert times is not None
    assert (times.state, times.reference, set(times.cameras)) == ("aligned", names[0], set(names))
    talk = capsys.readouterr().err
    assert f"left out {mute}: it cannot be aligned" in talk
    # Of two clips that start 1.2 s apart, the session has what both saw, and no image is missing.
    assert session.manifest.missing == ()
    assert "all cameras run for 4.8 s" in talk
