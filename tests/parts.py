"""Tests by turns: `--part 3/12` runs every twelfth of those that are collected, from the third on."""

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option."""
    parser.addoption("--part", metavar="N/PARTS", help="run every PARTS-th test, from the N-th on")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the other parts' tests out: neighbours, which cost alike, are of different parts."""
    if not (given := config.getoption("--part")):
        return
    number, parts = map(int, given.split("/"))
    own = sorted(items, key=lambda item: item.nodeid)[number - 1 :: parts]
    config.hook.pytest_deselected(items=[item for item in items if item not in own])
    items[:] = own
