"""Splats in a page to walk round in: 16 bytes a Gaussian."""

import base64
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.common.camera_paths import Frame
from reconstruction.common.geometry import Array, View
from reconstruction.methods.splat.gaussians import Gaussians, quaternions, read_splats, render_gaussians
from reconstruction.pages.walk_page import Drawing, write_walk_page

HELD = 4
"""Number of instants that the page keeps in the GPU's memory."""
BLUR = 0.3
"""Variance that every Gaussian has at least in a picture, px squared, as in `gaussians.c`."""
STRAY = 0.1
"""Percentile of the Gaussians' places, on both ends of each axis, beyond which they may be strays."""
BEYOND = 0.5
"""Farthest stray that is shown, in extents of all others."""


def write_splat_page(
    out: Path, name: str, files: Mapping[int, Path], frame: Frame, views: Mapping[str, View], period_ns: int
) -> None:
    """Write the page into a folder, with splats by instant; `views` are those that they were made from."""
    instants, first = list[dict[str, Any]](), None
    near, far = np.inf, 0.0
    for instant, file in files.items():
        gaussians = read_splats(file)
        first = gaussians if first is None else first
        instants.append({"instant": instant, **pack(gaussians)})
        for view in views.values():
            depth = gaussians.places @ view.rotation[2] + view.translation[2]
            near, far = min(near, float(depth[depth > 0].min())), max(far, float(depth.max()))
    assert first is not None
    shape = next(iter(views.values()))
    write_walk_page(
        out,
        name,
        frame=frame,
        depths=(near, far),
        views=views,
        still=render_gaussians(first, frame.view(frame.place(0, 0), shape.width, shape.height)),
        period_ns=period_ns,
        drawing=Drawing(
            Path(__file__).with_name("page") / "splats.js",
            instants,
            {
                "held": HELD,
                "blur": BLUR,
                # In the page's pictures, which are as wide as the views.
                "focal": float(np.median([view.focal for view in views.values()])),
            },
        ),
    )


def pack(gaussians: Gaussians) -> dict[str, Any]:
    """Return Gaussians for the page: 16 bits a coordinate, 8 bits for all else, compressed.

    A place is `low` + `step` times an integer, a size `smallest` times exp(`ratio` times an integer).
    """
    gaussians = gaussians.chosen(_without_strays(gaussians.places))
    low, high = gaussians.places.min(axis=0), gaussians.places.max(axis=0)
    step = np.maximum(high - low, 1e-9) / 65535
    places = np.rint((gaussians.places - low) / step).astype(np.uint32)
    smallest, largest = float(gaussians.sizes.min()), float(gaussians.sizes.max())
    ratio = max(np.log(largest / smallest), 1e-9) / 255
    sizes = np.rint(np.log(gaussians.sizes / smallest) / ratio).astype(np.uint32)
    turns = quaternions(gaussians.rotations)
    turns *= np.where(turns[:, :1] < 0, -1, 1)
    x, y, z = np.rint((turns[:, 1:] + 1) * 127.5).astype(np.uint32).T
    b, g, r = _bytes(gaussians.colours).T
    words = [
        places[:, 0] | places[:, 1] << 16,
        places[:, 2] | sizes[:, 0] << 16 | sizes[:, 1] << 24,
        sizes[:, 2] | x << 8 | y << 16 | z << 24,
        r | g << 8 | b << 16 | _bytes(gaussians.opacities) << 24,
    ]
    data = zlib.compress(np.stack(words).astype("<u4").tobytes(), 6)
    return {
        "number": len(gaussians),
        "low": low.tolist(),
        "step": step.tolist(),
        "smallest": smallest,
        "ratio": float(ratio),
        "splats": base64.b64encode(data).decode(),
    }


def _without_strays(places: Array) -> Array:
    """Return which places (bool) are not far beyond nearly all others; they would cost all precision."""
    low, high = np.percentile(places, [STRAY, 100 - STRAY], axis=0)
    margin = BEYOND * (high - low) + 1e-9
    return np.asarray(((places >= low - margin) & (places <= high + margin)).all(axis=1))


def _bytes(values: Array) -> Array:
    return np.asarray(np.rint(np.clip(values, 0, 1) * 255), np.uint32)
