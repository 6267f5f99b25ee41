"""Native libraries: the order in which they are imported, and machines that lack them."""

import subprocess
import sys
from pathlib import Path

import pytest

from capture_app.common.errors import ExitCode, NotAvailableError
from reconstruction.common.native_libraries import __file__, load_pycolmap

WRITES_A_PNG = """
import sys
from reconstruction.common.native_libraries import load_pycolmap
assert "cv2" not in sys.modules
load_pycolmap("testing")
import cv2
import numpy as np
assert cv2.imwrite(sys.argv[1], np.zeros((8, 8, 3), np.uint8))
"""


def test_a_png_can_be_written_after_colmap_is_loaded(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap has no package for this machine")
    picture = tmp_path / "p.png"
    done = subprocess.run(
        [sys.executable, "-c", WRITES_A_PNG, str(picture)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert picture.read_bytes().startswith(b"\x89PNG")


ENDED = """
import os, signal
from reconstruction.common.native_libraries import load_pycolmap
signal.signal(signal.SIGTERM, signal.default_int_handler)
load_pycolmap("testing")
try:
    os.kill(os.getpid(), signal.SIGTERM)
    signal.pause()
except KeyboardInterrupt:
    print("tidied up")
"""


def test_a_process_that_is_ended_still_tidies_up(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap has no package for this machine")
    done = subprocess.run([sys.executable, "-c", ENDED], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout, done.stderr) == (0, "tidied up\n", "")


def test_nothing_else_imports_colmap() -> None:
    folder = Path(__file__).parents[1]
    importers = [path.name for path in folder.rglob("*.py") if "import pycolmap" in path.read_text()]
    assert importers == []


def test_a_machine_without_colmap_is_told_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(NotAvailableError, match="mapping needs pycolmap, which is not installed") as caught:
        load_pycolmap("mapping", hint="give it a calibration.json")
    assert caught.value.exit_code == ExitCode.NOT_AVAILABLE
    assert str(caught.value).endswith("; or give it a calibration.json)")


def test_the_command_starts_without_heavy_imports() -> None:
    code = (
        "import sys, reconstruction.cli; "
        "assert not {'cv2', 'numpy', 'pycolmap', 'open3d', 'textual'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
