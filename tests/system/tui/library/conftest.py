"""Fixtures that these tests share with those of other folders."""

from tests.unit.tui.library.conftest import sessions as sessions
