"""Recordings of other projects, as their owners keep them, go through whole by one command."""

from pathlib import Path

import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.session.reading.reader import Session

WHOLE = {
    "sleap-anipose/minimal_session": (4, 120, "unknown"),
    "caliscope/charuco_calibration_2_cam": (2, 111, "recorded"),
    "caliscope/post_optimization": (4, 57, "recorded"),
    "pose2sim/Demo_SinglePerson": (4, 100, "unknown"),
    "pose2sim/Demo_MultiPerson": (4, 100, "unknown"),
}
"""Cameras, instants, and what is known of the times."""


@pytest.mark.shared
@pytest.mark.parametrize("name", WHOLE)
def test_a_folder_goes_through_whole(
    shared: Path, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cameras, instants, state = WHOLE[name]
    folder = shared / "footage" / "strangers" / name
    if not folder.is_dir():
        pytest.skip("no real recordings at shared/footage/strangers")
    assert run(["sessions", "import", str(folder), "--out", str(tmp_path)]) == ExitCode.OK
    session = Session.open(tmp_path / folder.name)
    burst = session.manifest.burst
    assert burst.common_times is not None
    assert (len(session.manifest.cameras), len(burst.instants_ns), burst.common_times.state) == WHOLE[name]
    assert session.manifest.missing == ()
    said = capsys.readouterr().err
    assert ("--synchronized" in said) == (state == "unknown")
    assert len(session.manifest.images) == cameras * instants
