"""A machine without what only some work needs: what runs, and what the rest says."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.project import JUMPER, ROOT

WITHOUT = """
import sys
class Without:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("open3d", "pycolmap"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Without())
"""
EVERY_MODULE = """
import importlib, pkgutil, capture_app, reconstruction
for package in (capture_app, reconstruction):
    for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if found.name != "capture_app.common.system.windows":
            importlib.import_module(found.name)
"""


@pytest.fixture
def capture_only(tmp_path: Path) -> dict[str, str]:
    """The environment of a Python, and of all it starts, in which reconstruction's packages are missing."""
    (tmp_path / "sitecustomize.py").write_text(WITHOUT)
    return {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}


def run(capture_only: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *arguments]
    return subprocess.run(command, env=capture_only, capture_output=True, text=True, check=False)


def test_a_scene_is_rendered_without_reconstruction(capture_only: dict[str, str]) -> None:
    """The first thing that a newcomer sees who installed no extra."""
    pytest.importorskip("embreex", reason="scenes are rendered by Embree")
    scene = "from capture_app.plugins.cameras.sim.rendering.scene import load; load('studio', scale=0.05)"
    assert run(capture_only, "-c", scene).returncode == 0


def test_no_module_needs_them(capture_only: dict[str, str]) -> None:
    done = run(capture_only, "-c", "import open3d")
    assert "No module named 'open3d'" in done.stderr, "they are missing indeed"
    done = run(capture_only, "-c", EVERY_MODULE)
    assert done.returncode == 0, done.stderr


def test_what_needs_them_says_so(capture_only: dict[str, str], tmp_path: Path) -> None:
    session = str(JUMPER)
    out = str(tmp_path / "out")
    done = run(capture_only, "-m", "reconstruction.cli", "multiview", session, "--mesh", "--out", out)
    assert done.returncode == 6, done.stderr
    assert "needs pycolmap, which is not installed" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr
    done = run(capture_only, "-m", "reconstruction.cli", "stereo", session, "--out", out)
    assert done.returncode == 0, done.stderr
