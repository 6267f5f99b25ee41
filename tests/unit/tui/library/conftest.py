"""A folder with takes in it, and the screen on it."""

from pathlib import Path

import pytest

from tests.unit.tui.takes import make_take


@pytest.fixture
def sessions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three takes: fair, excellent, poor; nothing is kept outside of the test's folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "sessions"
    for name, spread_ns in (("one", 1_400_000), ("two", 40_000), ("three", 22_000_000)):
        make_take(folder, name=name, spread_ns=spread_ns)
    return folder
