"""Flipped bits, torn journals and damaged images are noticed, and repaired where they can be."""

from pathlib import Path

import pytest

from tests.unit.session.writing.full_take import Take
from tests.unit.session.writing.test_damage import flipped_bits


@pytest.mark.timeout(3600)
def test_every_flipped_bit_is_noticed(tmp_path: Path) -> None:
    session = Take(tmp_path).write()
    assert flipped_bits(session.folder, lambda bits: iter(range(bits))) == []
