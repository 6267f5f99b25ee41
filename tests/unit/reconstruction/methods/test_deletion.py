"""A method is one folder: without it and its entry point, all else runs and says nothing of it."""

import subprocess
from collections.abc import Sequence

import pytest

from reconstruction.common.options import METHODS
from tests.project import ROOT
from tests.unit.packaging.cut_tree import ENTRIES, CutTree

NAMES = sorted(ENTRIES[METHODS])


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> CutTree:
    """A copy of the packages, which the tests take methods from."""
    return CutTree(tmp_path_factory.mktemp("tree"))


def run(tree: CutTree, gone: Sequence[str], *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run Python in the tree without some methods."""
    return tree.run([f"reconstruction/methods/{name}" for name in gone], *arguments)


def test_each_method_is_a_folder_with_one_entry_point() -> None:
    folder = ROOT / "reconstruction" / "methods"
    assert sorted(path.parent.name for path in folder.glob("*/__init__.py")) == NAMES
    for name, target in ENTRIES[METHODS].items():
        assert target.startswith(f"reconstruction.methods.{name}.")


def test_every_module_imports_without_any_method(tree: CutTree) -> None:
    code = "import pkgutil, reconstruction as r; "
    code += "[*map(__import__, (one.name for one in pkgutil.walk_packages(r.__path__, 'reconstruction.')))]"
    done = run(tree, NAMES, "-c", code)
    assert (done.returncode, done.stderr) == (0, "")
