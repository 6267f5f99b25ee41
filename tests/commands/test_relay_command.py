"""What `capture-app relay` says to mistakes: one line, the right exit code, and nothing left listening."""

import socket

import pytest

from capture_app.cli import run
from capture_app.errors import ExitCode


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        ([], ExitCode.USAGE, "LEADER"),
        (["10.0.0.1:port"], ExitCode.USAGE, "not HOST:PORT"),
        (["127.0.0.1", "--name", "a b"], ExitCode.USAGE, "is not a valid name for a node"),
        (["127.0.0.1", "--clock", "sundial"], ExitCode.BAD_INPUT, "unknown clock"),
        (["[::1]:5", "--host", "127.0.0.1", "--port", "0"], ExitCode.NETWORK, "not of one kind"),
    ],
)
def test_a_mistake_is_one_line(
    arguments: list[str], code: ExitCode, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["relay", *arguments]) == code
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert says in lines[0]


def test_a_port_in_use_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        assert run(["relay", "127.0.0.1", "--host", "127.0.0.1", "--port", port]) == ExitCode.NETWORK
    assert f"cannot listen on 127.0.0.1:{port}" in capsys.readouterr().err
