"""Moments in a page to walk round in: textured depth of all cameras."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.common.camera_paths import frame_of
from reconstruction.common.geometry import Array, View
from reconstruction.depth.seen_moment import Moment, SeenView
from reconstruction.depth.view_blending import TOLERANCE, render
from reconstruction.pages.walk_page import Drawing, image_address, path_of, write_walk_page

PICTURE_PX, GRID_PX = 960, 480
"""Longest side of the pictures, and of the depth maps whose pixels are the meshes' corners."""
EDGE = 1.04
"""Ratio of depths between neighbouring corners from which on there is an edge."""
LEVELS = 4094
"""Steps of inverse depth, in 12 bits of which 0 means unknown."""
HELD = 8
"""Number of instants that the page keeps in the GPU's memory."""


def write_moments(
    page: Path, name: str, moments: Mapping[int, Moment], subject: Array, period_ns: int
) -> None:
    """Write the page as a file, with moments by instant, to walk round a point (3,)."""
    cameras = {camera: seen.view for moment in moments.values() for camera, seen in moment.items()}
    first = next(iter(moments.values()))
    frame, shape = frame_of(cameras, subject), next(iter(cameras.values()))
    known = [seen.depth[seen.depth > 0] for moment in moments.values() for seen in moment.values()]
    write_walk_page(
        page,
        name,
        path=path_of(
            frame,
            (min(float(depth.min()) for depth in known), max(float(depth.max()) for depth in known)),
            cameras,
        ),
        views=cameras,
        still=render(frame.view(frame.place(0, 0), shape.width, shape.height), first).colours,
        period_ns=period_ns,
        drawing=Drawing(
            Path(__file__).with_name("page") / "meshes.js",
            [
                {"instant": k, "cameras": [_seen(camera, seen) for camera, seen in moment.items()]}
                for k, moment in moments.items()
            ],
            {
                "edge": EDGE,
                "tolerance": TOLERANCE,
                "held": HELD,
                "cameras": {camera: _camera(view) for camera, view in cameras.items()},
            },
        ),
    )


def _camera(view: View) -> dict[str, Any]:
    return {
        "width": view.width,
        "height": view.height,
        "lens": [*view.matrix[[0, 1], [0, 1]].tolist(), *view.matrix[:2, 2].tolist()],
        "rotation": view.rotation.ravel().tolist(),
        "centre": view.centre.tolist(),
    }


def _seen(camera: str, seen: SeenView) -> dict[str, Any]:
    small = seen.resized(GRID_PX).depth
    known = small[small > 0]
    near, far = (float(known.min()), float(known.max()) * 1.0001) if len(known) else (1.0, 2.0)
    with np.errstate(divide="ignore"):
        fraction = (1 / small - 1 / far) / (1 / near - 1 / far)
    level = np.where(small > 0, 1 + np.rint(np.clip(fraction, 0, 1) * LEVELS), 0).astype(np.uint16)
    # Red has the upper eight bits, green the lower four.
    packed = np.stack([np.zeros_like(level), (level & 15) << 4, level >> 4], axis=2).astype(np.uint8)
    return {
        "camera": camera,
        "near": near,
        "far": far,
        "picture": image_address(seen.resized(PICTURE_PX).colours, ".jpg"),
        "depth": image_address(packed, ".png"),
    }
