"""Fixtures that these tests share with those of other folders."""

from tests.system.end_to_end.conftest import start as start
