"""Folders of other programs are recognized, and our own exports come back with their times."""

from pathlib import Path

import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.imported import import_one
from tests.project import SAMPLES


def test_a_videos_own_times_are_those_of_its_export(tmp_path: Path) -> None:
    sample = SAMPLES / "crossing"
    out = tmp_path / "out"
    assert run(["sessions", "export", str(sample), "--to", "mp4", "--out", str(out)]) == ExitCode.OK
    session = import_one([str(out)], tmp_path, "s", ImportOptions(times="video"))
    assert verify(session) == []
    taken = Session.open(sample).images_by_instant()
    first_ns = min(record.leader_ns for record in taken[0].values())
    zero_ns = min(record.leader_ns for record in session.images_by_instant()[0].values())
    for before, after in zip(taken, session.images_by_instant(), strict=True):
        since = sorted(record.leader_ns - first_ns for record in before.values())
        again = sorted(record.leader_ns - zero_ns for record in after.values())
        assert again == pytest.approx(since, abs=1_000)
