"""Fixtures that these tests share with those of other folders."""

from tests.unit.net.conftest import _open as _open
