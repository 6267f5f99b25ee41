"""A comparison with pictures."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from reconstruction.scores.compare_results import CompareResult
from reconstruction.scores.results import Picture
from tests.reconstruction.report.results import RESULT, with_pictures


@pytest.fixture
def pictured(tmp_path: Path) -> CompareResult:
    """The result with three pictures on disk: ordinary, very wide and upright."""
    random = np.random.default_rng(1)
    (tmp_path / "pictures").mkdir()
    pictures = []
    for key, shape, suffix in (
        ("depth", (48, 64), "png"), ("pano", (40, 300), "jpg"), ("crop", (90, 30), "png")
    ):  # fmt: skip
        names = [f"pictures/{key}_{side}.{suffix}" for side in ("synced", "offset")]
        for name in names:
            assert cv2.imwrite(str(tmp_path / name), random.integers(0, 255, (*shape, 3), np.uint8))
        pictures.append(
            Picture(key=key, title=f'{key} "seen"', synced=names[0], offset=names[1], caption="a<b")
        )
    return with_pictures(RESULT, *pictures)
