"""The wall: without any wing, and without all but the simulated camera, everything else still runs."""

import pytest

from tests.unit.packaging.cut_tree import ENTRIES, WINGS, CutTree, wing_of

COMPANIONS = [wing for wing in WINGS if wing.startswith("capture_app/companions/")]
OTHERS = [wing for wing in WINGS if wing.startswith("capture_app/") and wing not in COMPANIONS]
HELP = """
import capture_app.cli, reconstruction.cli
assert capture_app.cli.run(["--help"]) == reconstruction.cli.run(["--help"]) == 0
"""


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> CutTree:
    return CutTree(tmp_path_factory.mktemp("tree"))


def test_every_wing_is_reached_by_entry_points_and_these_reach_wings_only() -> None:
    reached = {wing_of(target) for entries in ENTRIES.values() for target in entries.values()}
    assert reached == {*WINGS}


@pytest.mark.parametrize("wing", OTHERS)
def test_the_help_of_both_commands_works_without_a_wing(tree: CutTree, wing: str) -> None:
    done = tree.run([wing], "-c", HELP)
    assert (done.returncode, done.stderr) == (0, "")
