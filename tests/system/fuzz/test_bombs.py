"""Small files that ask for far more than they have bytes: each reader's budget of memory and time."""

from pathlib import Path

import pytest

from capture_app.session.importing.importer import load_importers
from tests.costs import LOOP_S, cpu_s, loop_s
from tests.fuzz.bombs import BOMBS
from tests.fuzz.readers import READERS

MEGABYTES, CPU_S = 300, 2.0
"""Budget of one reader."""


@pytest.fixture(scope="module", autouse=True)
def _importers() -> None:
    """Import now what each of them needs, which is no part of a budget."""
    load_importers()


def most_resident_mb() -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) // 1024


@pytest.mark.parametrize(("reader", "name"), [(reader, name) for reader, of in BOMBS.items() for name in of])
def test_a_bomb_takes_no_more_than_its_budget(reader: str, name: str, tmp_path: Path) -> None:
    data = BOMBS[reader][name]()
    # Linux counts anew from here on.
    Path("/proc/self/clear_refs").write_text("5")
    before_mb, before_s = most_resident_mb(), cpu_s()
    READERS[reader](data, tmp_path)
    took_mb, took_s = most_resident_mb() - before_mb, cpu_s() - before_s
    assert took_mb < MEGABYTES
    assert took_s < CPU_S * max(1.0, loop_s() / LOOP_S)
