"""Fixtures that these tests share with those of other folders."""

from tests.unit.plugins.programs.conftest import make as make
from tests.unit.plugins.programs.conftest import export as export
