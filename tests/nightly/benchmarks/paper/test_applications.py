"""The paper's applications on its page: read from what `reconstruct compare` writes."""

from pathlib import Path

from benchmarks.paper.applications import compare_samples, read_compared
from tests.unit.benchmarks.paper.test_applications import (
    compared,  # noqa: F401 - a fixture
)


def test_the_quick_form_makes_all_of_them_small(tmp_path: Path) -> None:
    compared = compare_samples(tmp_path / "compared", quick=True)
    out = tmp_path / "out"
    out.mkdir()
    made = {one.key: one for one in read_compared(compared, out)}
    assert all(one.measures for one in made.values())
    assert all((out / name).stat().st_size for one in made.values() for name in one.files)
    assert "OpenCV" in made["figure-8"].engine
    assert "plane sweep" in made["five-views"].engine
