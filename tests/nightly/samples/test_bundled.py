"""The bundled sample sessions: whole, true, small, and the same bytes again from their recipes."""

from pathlib import Path

import pytest

from benchmarks.samples.recipe import read_recipe
from benchmarks.samples.render import render, same_files
from tests.project import SAMPLES
from tests.unit.samples.test_bundled import NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_sample_rendered_again_has_the_same_bytes(name: str, tmp_path: Path) -> None:
    render(read_recipe(SAMPLES / name), tmp_path)
    assert same_files(tmp_path / name, SAMPLES / name)
