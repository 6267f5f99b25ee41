"""Fixtures that these tests share with those of other folders."""

from tests.unit.reconstruction.methods.multiview.conftest import trio as trio
