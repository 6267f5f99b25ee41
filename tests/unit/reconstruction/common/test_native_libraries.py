"""Native libraries: the order in which they are imported, and machines that lack them."""

import subprocess
import sys
from pathlib import Path

import pytest

from capture_app.common.errors import ExitCode, NotAvailableError
from reconstruction.common.colmap import load_pycolmap
from tests.project import ROOT

WRITES_A_PNG_AND_IS_ENDED = """
import os, signal, sys
from reconstruction.common.colmap import load_pycolmap
assert "cv2" not in sys.modules
signal.signal(signal.SIGTERM, signal.default_int_handler)
load_pycolmap("testing")
import cv2
import numpy as np
assert cv2.imwrite(sys.argv[1], np.zeros((8, 8, 3), np.uint8))
try:
    os.kill(os.getpid(), signal.SIGTERM)
    signal.pause()
except KeyboardInterrupt:
    print("tidied up")
"""


def test_with_colmap_a_process_writes_pngs_and_tidies_up_when_it_is_ended(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap has no package for this machine")
    picture = tmp_path / "p.png"
    command = [sys.executable, "-c", WRITES_A_PNG_AND_IS_ENDED, str(picture)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout, done.stderr) == (0, "tidied up\n", "")
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_nothing_else_imports_colmap() -> None:
    importers = [
        path.name for path in (ROOT / "reconstruction").rglob("*.py") if "import pycolmap" in path.read_text()
    ]
    assert importers == []


def test_a_machine_without_colmap_is_told_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(NotAvailableError, match="mapping needs pycolmap, which is not installed") as caught:
        load_pycolmap("mapping", hint="give it a calibration.json")
    assert caught.value.exit_code == ExitCode.NOT_AVAILABLE
    assert str(caught.value).endswith("; or give it a calibration.json)")
