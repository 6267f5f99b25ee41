"""Fixtures that these tests share with those of other folders."""

from tests.unit.node.conftest import leader as leader
from tests.unit.node.conftest import trust as trust
