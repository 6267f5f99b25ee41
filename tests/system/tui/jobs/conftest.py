"""Fixtures that these tests share with those of other folders."""

from tests.unit.tui.jobs.conftest import session as session
