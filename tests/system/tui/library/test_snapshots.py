"""How the mode Sessions looks: three sizes, and other colours."""

from pathlib import Path
from typing import Any

import pytest

from tests.unit.tui.library.test_snapshots import (
    folder,  # noqa: F401 - a fixture
    make,
    ready,
)

pytestmark = pytest.mark.usefixtures("utc")


def test_the_list_looks_as_it_did(snap_compare: Any, folder: Path) -> None:
    assert snap_compare(make(folder), terminal_size=(200, 50), run_before=ready)
