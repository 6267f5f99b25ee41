"""Broken and odd calibrations, pictures and manifests: each command ends with a line and an exit code.

All of them through all commands, as processes whose memory is measured, take most of an hour of CPU; a few
quick ones are unit tests.
"""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.unit.reconstruction.commands.commands import COMMANDS, command_line, faults
from tests.unit.reconstruction.commands.server import Server
from tests.unit.reconstruction.commands.test_odd_inputs import (
    CASES,
    make_odd,
    sound,  # noqa: F401 - a fixture
)

WITHOUT_CALIBRATION = ("panorama of pictures", "calibrate from charuco", "calibrate from sfm")
"""Commands that do not read the session's calibration: of no other calibration they notice anything."""


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    server = Server()
    yield server
    server.close()


@pytest.mark.timeout(7200)
@pytest.mark.parametrize("case", CASES)
def test_every_command_ends_with_a_line_and_an_exit_code(
    case: str, sound: Path, server: Server, tmp_path: Path
) -> None:
    session = make_odd(case, sound, tmp_path)
    wrong = {}
    for command in COMMANDS:
        if case.startswith("calibration: ") and command in WITHOUT_CALIBRATION:
            continue
        run = server.run(tmp_path, *command_line(command, session, tmp_path / "out"))
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        if found := faults(run):
            wrong[command] = (found, run.err[-600:])
    assert not wrong
