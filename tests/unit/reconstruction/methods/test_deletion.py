"""A method, check or command is one folder: without it and its entry point, the rest runs without it."""

import subprocess
from collections.abc import Sequence

import pytest

from reconstruction.common.options import CHECKS, COMMANDS, METHODS
from tests.project import ROOT
from tests.unit.packaging.cut_tree import ENTRIES, CutTree

FOLDERS = {"methods": ENTRIES[METHODS] | ENTRIES[COMMANDS], "checks": ENTRIES[CHECKS]}
NAMES = sorted(name for entries in FOLDERS.values() for name in entries)


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> CutTree:
    """A copy of the packages, which the tests take methods from."""
    return CutTree(tmp_path_factory.mktemp("tree"))


def run(tree: CutTree, gone: Sequence[str], *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run Python in the tree without some methods."""
    wings = [
        f"reconstruction/{of}/{name}" for of, entries in FOLDERS.items() for name in gone if name in entries
    ]
    return tree.run(wings, *arguments)


@pytest.mark.parametrize("of", FOLDERS)
def test_each_method_and_check_is_a_folder_with_one_entry_point(of: str) -> None:
    folder = ROOT / "reconstruction" / of
    assert sorted(path.parent.name for path in folder.glob("*/__init__.py")) == sorted(FOLDERS[of])
    for name, target in FOLDERS[of].items():
        assert target.startswith(f"reconstruction.{of}.{name}.")


def test_every_module_imports_without_any_method(tree: CutTree) -> None:
    code = "import pkgutil, reconstruction as r; "
    code += "[*map(__import__, (one.name for one in pkgutil.walk_packages(r.__path__, 'reconstruction.')))]"
    done = run(tree, NAMES, "-c", code)
    assert (done.returncode, done.stderr) == (0, "")
