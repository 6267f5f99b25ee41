"""The examples of "In Python" and of the README print what the pages say they print."""

import contextlib
import io
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest

import capture_app
import reconstruction
from tests.project import ROOT, SAMPLES

PAGE = ROOT / "docs" / "python.md"
_BLOCK = re.compile(r"(?P<slow><!-- slow -->\n)?```python\n(?P<code>.*?)```", re.DOTALL)
_SAYS = "# > "


@dataclass(frozen=True)
class Example:
    """A block of Python on a page, and what it says that it prints."""

    code: str
    slow: bool

    @property
    def said(self) -> list[str]:
        return [line.removeprefix(_SAYS) for line in self.code.splitlines() if line.startswith(_SAYS)]

    def run(self, names: dict[str, object]) -> list[str]:
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            exec(compile(self.code, PAGE.name, "exec"), names)
        return printed.getvalue().splitlines()


EXAMPLES = [Example(found["code"], found["slow"] is not None) for found in _BLOCK.finditer(PAGE.read_text())]


@pytest.fixture
def project(tmp_path: Path) -> Iterator[Path]:
    """A folder with the samples in it, as the project's, to write into."""
    shutil.copytree(SAMPLES, tmp_path / "sample_sessions")
    with contextlib.chdir(tmp_path):
        yield tmp_path


def test_there_are_ten_examples() -> None:
    assert len(EXAMPLES) >= 10
    assert all(example.said for example in EXAMPLES)


@pytest.mark.usefixtures("project")
def test_quick_examples_print_what_the_page_says() -> None:
    names: dict[str, object] = {}
    for example in EXAMPLES:
        if not example.slow:
            assert example.run(names) == example.said


def test_the_readmes_lines_print_shape_time_and_error_bar() -> None:
    code = next(found["code"] for found in _BLOCK.finditer((ROOT / "README.md").read_text()))
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    said = [line.removeprefix(_SAYS) for line in code.splitlines() if line.startswith(_SAYS)]
    assert (done.stdout.splitlines(), done.stderr) == (said, "")


def test_importing_the_package_stays_light() -> None:
    code = "import sys, capture_app, reconstruction; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    heavy = {"numpy", "cv2", "msgspec", "asyncio", "textual", "pycolmap", "open3d", "click"}
    assert not heavy & set(loaded.stdout.split())


@pytest.mark.parametrize("package", [capture_app, reconstruction])
def test_tab_completion_finds_the_public_names(package: ModuleType) -> None:
    names = [name for name in dir(package) if not name.startswith("_")]
    assert names == package.__all__
    assert "open_session" in names
    assert all(getattr(package, name).__doc__ for name in names)
