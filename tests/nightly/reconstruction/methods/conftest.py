"""Fixtures that these tests share with those of other folders."""

from tests.unit.reconstruction.methods.conftest import browser as browser
