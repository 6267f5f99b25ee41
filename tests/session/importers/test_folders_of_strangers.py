"""Folders as strangers have them become sessions by one command without an option."""

import os
from pathlib import Path

import pytest

from capture_app.cli import run
from capture_app.errors import ExitCode
from capture_app.session.library.listing import list_sessions
from capture_app.session.reading.reader import Session
from tests.session.importers.numbered_video import write_video
from tests.session.importers.strangers import FOLDERS, MIDDLE_NS, true_offset_ms


@pytest.mark.slow
@pytest.mark.parametrize("name", FOLDERS)
def test_one_command_without_an_option(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, root = FOLDERS[name], tmp_path / "my shoot"
    folder.make(root)
    out = tmp_path / "out"
    assert run(["sessions", "import", str(root), "--out", str(out)]) == ExitCode.OK
    printed = capsys.readouterr()
    assert folder.said in printed.out + printed.err
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


def test_what_is_imported_and_exported_is_for_its_owner_and_group(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        write_video(tmp_path / "clip.mp4", (0, 33_000, 66_000))
        out, exported = tmp_path / "out", tmp_path / "exported"
        clip = [str(tmp_path / "clip.mp4"), "--name", "s"]
        assert run(["sessions", "import", *clip, "--out", str(out)]) == ExitCode.OK
        assert (
            run(["sessions", "export", str(out / "s"), "--to", "colmap", "--out", str(exported)])
            == ExitCode.OK
        )
    finally:
        os.umask(before)
    made = [path for root in (out / "s", exported) for path in (root, *root.rglob("*"))]
    modes = {(path.is_dir(), path.stat().st_mode & 0o777) for path in made}
    assert modes == {(True, 0o750), (False, 0o640)}
