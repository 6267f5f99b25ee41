"""Fixtures of tests of methods."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.browser import CHROMIUM, Browser


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    """A browser that draws WebGL by software."""
    if CHROMIUM is None:
        pytest.skip("chromium is not installed")
    shown = Browser(tmp_path / "profile", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
    shown.start()
    yield shown
    shown.close()
