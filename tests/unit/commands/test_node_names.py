"""Names of a node's folders, whose owner may have named it in any script."""

import socket
from pathlib import Path

import pytest

from capture_app.commands.node import _folder_of

ONE, TWO = ("v4l2:/dev/video0",), ("v4l2:/dev/video0", "v4l2:/dev/video2")


@pytest.fixture(autouse=True)
def machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "gethostname", lambda: "pi")


def test_names_without_a_letter_of_ascii_differ_on_one_machine(tmp_path: Path) -> None:
    left, right = (_folder_of(name, ONE, tmp_path) for name in ("左", "右"))
    assert left != right
    assert {name.partition("-")[0] for name in (left, right)} == {"pi"}
    assert _folder_of("left", ONE, tmp_path) == "left"


@pytest.mark.parametrize(("specs", "camera"), [(ONE, "pi0"), (TWO, "pi0-video2")])
def test_a_spool_of_before_is_gone_on_with(tmp_path: Path, specs: tuple[str, ...], camera: str) -> None:
    """Images that it has were left there for ever, and the rig had another camera."""
    (tmp_path / camera).mkdir()
    assert _folder_of("左", specs, tmp_path) == "pi0"
    assert _folder_of("left", specs, tmp_path) == "left"
