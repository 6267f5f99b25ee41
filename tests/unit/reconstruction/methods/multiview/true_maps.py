"""A stand-in for matching that takes no time: each map is the true depth of its image, seen head-on."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from reconstruction.common.geometry import Array
from reconstruction.depth.plane_sweep import Surface
from reconstruction.methods.multiview import instant_maps
from reconstruction.methods.multiview.input_images import InputImage, undistorted_truth
from reconstruction.methods.multiview.sweep_matcher import ViewDepth
from reconstruction.scene.dataset import Dataset


def true_view(depth: Array) -> ViewDepth:
    """A map as the sweep returns it, of this depth (0 = none)."""
    inverse = np.where(depth > 0, 1 / np.maximum(depth, 1e-9), 0).astype(np.float32)
    facing = np.zeros((*depth.shape, 3), np.float32)
    facing[..., 2] = -1
    return ViewDepth(depth, facing, Surface(inverse, *[np.zeros_like(inverse)] * 3))


def match_truly(
    monkeypatch: pytest.MonkeyPatch, dataset: Dataset, spoil: Mapping[str, Any] | None = None
) -> None:
    """Let cameras be matched so; `spoil` changes a camera's depth, from it and its moving pixels (bool)."""

    def match(
        matcher: Any, workspace: Path, images: Mapping[str, InputImage], *_: Any
    ) -> dict[str, ViewDepth]:
        maps = {}
        for name, image in images.items():
            truth = undistorted_truth(dataset, image.view, name, image.instant)
            assert truth is not None
            maps[name] = true_view((spoil or {}).get(name, lambda depth, _: depth)(*truth))
        return maps

    monkeypatch.setattr(instant_maps, "match_cameras", match)
