"""Fixtures that these tests share with those of other folders."""

from tests.unit.plugins.cameras.conftest import stamps_are_the_drivers_own as stamps_are_the_drivers_own
