"""The bundled sample sessions rendered again from their recipes: the same times and truth, the same pictures.

Which of two surfaces that touch is seen depends on Embree's build; an earlier one rendered the samples.
"""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.samples.recipe import read_recipe
from benchmarks.samples.render import render
from tests.project import SAMPLES
from tests.unit.samples.test_bundled import NAMES

STATE_BYTES = {"checksums.sha256", "journal.ndjson"}
"""Files that state the bytes of others, and nothing that `session.json` does not."""
SAME = {".jpg": 8, ".npz": 0.001}
"""Difference within which a value is the same: grey levels, or metres of true depth."""
MAX_OTHER = 0.005
"""Part of a picture's pixels that may be another surface's."""


def stated(path: Path) -> str:
    """Return a file's text without the bytes of others, and without what is unknown (null)."""
    return re.sub(r',?\s*"(\w+": *null|(sha256|bytes)": *("[0-9a-f]*"|[0-9]+))', "", path.read_text())


def values(path: Path) -> dict[str, np.ndarray]:
    if path.suffix == ".npz":
        return {name: values.astype(float) for name, values in np.load(path).items()}
    return {"": cv2.imread(str(path)).astype(float)}


@pytest.mark.parametrize("name", NAMES)
def test_a_sample_rendered_again_shows_the_same(name: str, tmp_path: Path) -> None:
    render(read_recipe(SAMPLES / name), tmp_path)
    again, kept = tmp_path / name, SAMPLES / name
    paths = {path.relative_to(kept) for path in kept.rglob("*") if path.is_file()}
    assert paths == {path.relative_to(again) for path in again.rglob("*") if path.is_file()}
    for path in paths - {Path(name) for name in STATE_BYTES}:
        if path.suffix not in SAME:
            assert stated(again / path) == stated(kept / path), path
            continue
        first, second = values(again / path), values(kept / path)
        assert first.keys() == second.keys()
        for key, array in first.items():
            assert (np.abs(array - second[key]) > SAME[path.suffix]).mean() < MAX_OTHER, (path, key)
