"""Fixtures that these tests share with those of other folders."""

from tests.unit.plugins.programs.conftest import export as export
from tests.unit.plugins.programs.conftest import make as make
