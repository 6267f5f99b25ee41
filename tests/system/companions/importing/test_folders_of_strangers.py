"""Folders as strangers have them become sessions by one command without an option."""

from pathlib import Path

import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.session.library.listing import list_sessions
from capture_app.session.reading.reader import Session
from tests.unit.companions.importing.strangers import FOLDERS, MIDDLE_NS, true_offset_ms

OFTEN = (
    "flashes",
    "one flash",
    "timecode",
    "timecodes of recorded time",
    "a lamp, and a timecode that agrees",
    "a lamp, and a timecode that disagrees",
    "timecodes of clocks that nobody set",
    "nothing tells",
    "three, one of them deaf",
    "stray files",
    "takes by date",
    "a calibration beside",
    "two chapters of three cameras",
    "one of three is mute",
    "one upside down",
    "a zip",
    "a folder of images a camera",
    "images of two cameras in one folder",
)
"""The folders that are tried with every change; tests/nightly tries the others."""


@pytest.mark.parametrize("name", OFTEN)
def test_one_command_without_an_option(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import_folder(name, tmp_path, capsys)


def import_folder(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Import a stranger's folder of recordings with one command, and check what is said and made."""
    folder, root = FOLDERS[name], tmp_path / "my shoot"
    out = tmp_path / "out"
    code = run(["sessions", "import", str(folder.make(root)), "--out", str(out)])
    printed = capsys.readouterr()
    assert folder.said in printed.out + printed.err
    # Without the lines of progress, which are one bar in a terminal.
    shown = [line for line in (printed.out + printed.err).splitlines() if not line.startswith("[")]
    assert len(shown) <= 27 * max(1, len(folder.sessions))
    assert code == (ExitCode.BAD_INPUT if folder.refused else ExitCode.OK)
    if folder.refused:
        assert not out.exists()
        return
    assert "next: " in printed.err
    made = [Session.open(one.folder) for one in list_sessions(out)]
    assert [len(session.manifest.cameras) for session in made] == list(folder.sessions)
    for session in made:
        times = session.manifest.burst.common_times
        assert times is not None
        assert (session.calibration() is not None) == folder.calibrated
        assert times.unknown == (not folder.sources)
        for camera, of in times.cameras.items():
            found_ms = (of.leader_from_local(MIDDLE_NS) - MIDDLE_NS) / 1e6
            bar_ms = (of.uncertainty_at_ns(MIDDLE_NS) or 0) / 1e6
            error_ms = abs(found_ms - true_offset_ms(folder, camera, times.reference))
            assert error_ms <= bar_ms + 1e-6 < 45, camera
        assert {one.source for one in times.cameras.values()} - {"reference"} == set(folder.sources)
