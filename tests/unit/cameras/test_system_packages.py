"""Modules of the system's Python, from an environment that does not see them."""

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest

from capture_app.cameras.system_packages import FOLDERS, load_system_module
from capture_app.common.errors import NotAvailableError

MODULE = "simulshot_bindings"
HERE = f"{sys.version_info.major}.{sys.version_info.minor}"


@pytest.fixture
def dist_packages(tmp_path: Path) -> Iterator[Path]:
    """A folder like the system's, with a package and one that nobody asked for."""
    package = tmp_path / MODULE
    package.mkdir()
    (package / "__init__.py").write_text("from .inner import answer\n")
    (package / "inner.py").write_text("answer = 42\n")
    (tmp_path / "simulshot_neighbour.py").write_text("")
    yield tmp_path
    for name in [name for name in sys.modules if name.partition(".")[0] == MODULE]:
        del sys.modules[name]


def load(*folders: Path) -> object:
    return load_system_module(MODULE, "python3-bindings", "this camera", folders=folders)


def test_a_module_of_the_system_is_found_with_its_submodules_and_nothing_beside_it(
    dist_packages: Path, tmp_path: Path
) -> None:
    path = list(sys.path)
    module = load(tmp_path / "not-there", dist_packages)
    assert getattr(module, "answer", None) == 42
    assert sys.path == path
    assert load(dist_packages) is module
    with pytest.raises(ModuleNotFoundError):
        __import__("simulshot_neighbour")


def test_what_is_not_installed_names_the_package_that_brings_it(tmp_path: Path) -> None:
    with pytest.raises(NotAvailableError, match=rf"this camera needs .*{MODULE}.* not installed") as caught:
        load(tmp_path)
    assert "apt install python3-bindings" in caught.value.hint


def test_bindings_of_other_pythons_are_refused_in_words(dist_packages: Path) -> None:
    for version in ("310", "39"):
        (dist_packages / MODULE / f"_inner.cpython-{version}-aarch64-linux-gnu.so").write_bytes(b"")
    with pytest.raises(
        NotAvailableError, match=rf"for Python 3\.9 and 3\.10; this is Python {HERE}"
    ) as caught:
        load(dist_packages)
    assert "PYTHON=/usr/bin/python3.10" in caught.value.hint
    assert MODULE not in sys.modules


def test_bindings_of_this_python_beside_those_of_others_are_taken(dist_packages: Path) -> None:
    for suffix in (".cpython-39-aarch64-linux-gnu.so", EXTENSION_SUFFIXES[0]):
        (dist_packages / MODULE / f"_inner{suffix}").write_bytes(b"")
    assert getattr(load(dist_packages), "answer", None) == 42


def test_a_module_that_does_not_load_says_why_and_is_not_left_half_loaded(dist_packages: Path) -> None:
    (dist_packages / MODULE / "__init__.py").write_text('raise ImportError("libfoo.so.4: not found")\n')
    with pytest.raises(NotAvailableError, match=r"does not load here: libfoo\.so\.4") as caught:
        load(dist_packages)
    assert "python3-bindings" in caught.value.hint
    assert MODULE not in sys.modules


def test_this_systems_own_bindings_load_where_they_are_for_this_python() -> None:
    folder = Path(FOLDERS[0], "gi")
    if not list(folder.glob(f"_gi{EXTENSION_SUFFIXES[0]}")):
        pytest.skip("python3-gi is not installed for this Python")
    gi = load_system_module("gi", "python3-gi", "this camera")
    assert gi.require_version


def test_two_threads_are_given_a_whole_module(tmp_path: Path) -> None:
    (tmp_path / "slow_module.py").write_text("import time; time.sleep(0.05); ready = True")

    def load(_: int) -> bool:
        return bool(load_system_module("slow_module", "x", "y", folders=[tmp_path]).ready)

    with ThreadPoolExecutor(2) as threads:
        assert list(threads.map(load, range(2))) == [True, True]
