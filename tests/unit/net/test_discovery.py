"""A node finds the leaders of its network by itself, and believes only those that answer."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from capture_app import __version__
from capture_app.net.discovery import NOBODY, announced_hosts

from .machines import Machine, two_machines

TRIES = 50


@contextmanager
def announcing(machine: Machine, *what: str) -> Iterator[None]:
    program = machine.start_python("-m", "tests.unit.net.announcing", *what)
    try:
        assert program.stdout is not None
        assert program.stdout.readline() == "announcing\n"
        yield
    finally:
        program.kill()
        program.communicate()


def searched(machine: Machine, *trust: str) -> list[str]:
    """What a search finds; an announcement that has not come yet may be missing."""
    said, _ = machine.start_python("-m", "tests.unit.net.searching", *trust).communicate()
    return [line for line in said.splitlines() if line.startswith("found")]


def searched_until(machine: Machine, wanted: list[str], *trust: str) -> list[str]:
    """Search until these addresses are found, and no others; on a starved machine that takes several."""
    for _ in range(TRIES):
        found = searched(machine, *trust)
        if [line.split()[1] for line in found] == wanted:
            return found
    raise AssertionError(f"{found}, not {wanted}")


@pytest.fixture(scope="module")
def machines() -> Iterator[tuple[Machine, Machine]]:
    with two_machines() as both:
        yield both


def test_a_leader_is_found_and_a_relay_beside_it_is_left_alone(machines: tuple[Machine, Machine]) -> None:
    leader, node = machines
    with announcing(leader, "relay:47021:gate", "leader:47020:studio"):
        found = searched_until(node, ["10.77.0.1:47020"])
    assert found == [f"found 10.77.0.1:47020 studio-47020 '{__version__}'"]


def test_one_that_is_started_later_is_found_then_and_what_it_tells_steers_no_terminal(
    machines: tuple[Machine, Machine],
) -> None:
    leader, node = machines
    search = node.start_python("-m", "tests.unit.net.searching")
    try:
        assert search.stdout is not None
        assert search.stdout.readline() == f"said {NOBODY}\n"
        with announcing(leader, "strange-leader:47050:late"):
            found = search.stdout.readline()
        assert found.startswith("found 10.77.0.1:47050 late '\\\\x1b[2J xxx")
        assert len(found) < 150  # of a name or a version no more than that is told
    finally:
        search.kill()
        search.communicate()


def test_what_is_in_the_way_to_one_that_is_announced_is_said(machines: tuple[Machine, Machine]) -> None:
    leader, node = machines
    search = node.start_python("-m", "tests.unit.net.searching")
    try:
        assert search.stdout is not None
        with announcing(leader, "silent-leader:47060:shut"):
            lines = iter(search.stdout.readline, "")
            assert any("no leader listens on its port 47060" in line for line in lines)
    finally:
        search.kill()
        search.communicate()


def test_what_only_this_machine_reaches_is_not_announced() -> None:
    assert announced_hosts("127.0.0.1") == []
    assert announced_hosts("localhost") == []
    assert announced_hosts("::1") == []
    assert announced_hosts("192.0.2.77") == ["192.0.2.77"]


def test_a_machine_whose_network_comes_up_later_finds_the_leader_then() -> None:
    with two_machines() as (leader, node):
        node.ip("link", "set", "cable", "down")
        search = node.start_python("-m", "tests.unit.net.searching")
        try:
            assert search.stdout is not None
            assert search.stdout.readline() == f"said {NOBODY}\n"
            with announcing(leader, "leader:47070:studio"):
                node.ip("link", "set", "cable", "up")
                lines = iter(search.stdout.readline, "")
                assert any(line.startswith("found 10.77.0.1:47070 studio") for line in lines)
        finally:
            search.kill()
            search.communicate()
