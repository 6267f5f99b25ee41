"""A node finds the leaders of its network by itself, and believes only those that answer."""

from pathlib import Path

from capture_app.common.pairing_codes import Role
from capture_app.trust.trust import Trust
from tests.unit.net.machines import Machine
from tests.unit.net.test_discovery import (
    announcing,
    machines,  # noqa: F401 - a fixture  # noqa: F401 - a fixture
    searched_until,
)


def test_a_leader_names_the_others_of_its_rig_to_those_who_can_check_them(
    machines: tuple[Machine, Machine], tmp_path: Path
) -> None:
    leader, node = machines
    with announcing(leader, "leader:47025:first:10.77.0.1+10.77.0.9"):
        (found,) = searched_until(node, ["10.77.0.1:47025"], str(tmp_path))
        (found_openly,) = searched_until(node, ["10.77.0.1:47025"])
    assert found.split()[-1] == "10.77.0.1+10.77.0.9"
    assert "10.77.0.9" not in found_openly, "anybody can announce anything"


def test_of_several_leaders_the_one_that_is_known_is_taken(
    machines: tuple[Machine, Machine], tmp_path: Path
) -> None:
    leader, node = machines
    ours, own = Trust(tmp_path / "ours"), Trust(tmp_path / "own")
    own.known.add(ours.identity.pin, Role.LEADER, name="ours")
    with announcing(leader, f"leader@{tmp_path}/a:47080:a", f"leader@{ours.folder}:47081:z"):
        assert searched_until(node, ["10.77.0.1:47081"], str(own.folder))
