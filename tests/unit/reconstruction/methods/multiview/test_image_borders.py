"""What an undistorted picture has beyond the original one gets no depth."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from reconstruction.depth.rough_scene import RoughScene
from reconstruction.methods.multiview import matcher
from reconstruction.methods.multiview.input_images import InputImage, undistort_image
from reconstruction.methods.multiview.sweep_matcher import ViewDepth
from tests.unit.reconstruction.conftest import make_view


def pincushion(k1: float) -> InputImage:
    rng = np.random.default_rng(1)
    view = replace(make_view((0, 0, 0)), distortion=np.array([k1, 0, 0, 0, 0]))
    return undistort_image("cam0", 0, rng.integers(1, 255, (240, 320, 3), np.uint8), view)


@pytest.mark.parametrize(("k1", "black"), [(0.3, True), (0.0, False), (-0.1, False)])
def test_pixels_beyond_the_picture_are_found(k1: float, black: bool) -> None:
    image = pincushion(k1)
    assert image.outside.any() == black
    assert (image.colours[~image.outside] > 0).any(1).all()
    assert image.outside.mean() < 0.2


def test_they_get_no_depth(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    image = pincushion(0.3)
    whole = ViewDepth(np.ones((240, 320), np.float32), np.ones((240, 320, 3), np.float32))
    given: dict[str, Any] = {}

    def match_all_views(*_: Any, **options: Any) -> dict[str, ViewDepth]:
        given.update(options)
        return {"cam0": whole}

    monkeypatch.setattr(matcher, "match_all_views", match_all_views)
    rough = RoughScene({}, {}, has_thin=True)
    found = matcher.match_cameras(matcher.ChosenMatcher(), tmp_path, {"cam0": image}, {}, rough)["cam0"]
    assert given["has_thin"]
    assert (found.depth[image.outside] == 0).all()
    assert (found.normals[image.outside] == 0).all()
    assert (found.depth[~image.outside] == 1).all()
