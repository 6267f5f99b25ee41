"""The blocks of commands of all pages that tests/system does not run."""

import pytest

from tests.system.documentation.test_running import (
    CASES,
    RUN_BY_EVERY_CHANGE,
    World,
    run_page,
    world,  # noqa: F401 - a fixture
)


@pytest.mark.timeout(1200)  # calibrations by pictures: minutes of processor time, beside three other tests
@pytest.mark.parametrize(
    "name", [name for name, page in CASES.items() if page.stem not in RUN_BY_EVERY_CHANGE]
)
def test_a_pages_blocks_run(name: str, world: World) -> None:
    run_page(CASES[name], world)
