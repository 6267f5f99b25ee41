"""`reconstruct live` outside the screen, which alone sends it previews."""

import io
import sys
from types import SimpleNamespace

import pytest

from capture_app.common.errors import ExitCode
from capture_app.session.format.live_pictures import LENGTH
from tests.unit.reconstruction.conftest import Reconstruct


@pytest.mark.parametrize("given", [b"", b"localhost\n", LENGTH.pack(3) + b"abc"])
def test_without_previews_on_stdin(
    reconstruct: Reconstruct, monkeypatch: pytest.MonkeyPatch, given: bytes
) -> None:
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(given)))
    refused = reconstruct("live")
    assert refused.code == ExitCode.BAD_INPUT
    assert "there are no previews of a rig on stdin" in refused.complaint


def test_the_help_lists_what_people_type(reconstruct: Reconstruct) -> None:
    shown = reconstruct("--help").out
    assert "\n  batch  " in shown
    assert "\n  live  " not in shown
