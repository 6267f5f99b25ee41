"""A page to walk round in: textured depth of all cameras in one HTML file, for any browser with WebGL 2."""

import base64
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jinja2 import Environment, StrictUndefined

from capture_app.common.text import count
from reconstruction.common.geometry import Array, View
from reconstruction.depth.camera_paths import Frame, find_subject, frame_of
from reconstruction.depth.seen_moment import Moment, SeenView
from reconstruction.depth.view_blending import TOLERANCE, render

PAGE = "walk.html"
TEMPLATES = Path(__file__).with_name("page")
PICTURE_PX, GRID_PX = 960, 480
"""Longest side of the pictures, and of the depth maps whose pixels are the meshes' corners."""
QUALITY = 85
EDGE = 1.04
"""Ratio of depths between neighbouring corners from which on there is an edge."""
LEVELS = 4094
"""Steps of inverse depth, in 12 bits of which 0 means unknown."""
HELD = 8
"""Number of instants that the page keeps in the GPU's memory."""


def write_walk_page(out: Path, name: str, moments: Mapping[int, Moment], period_ns: int) -> None:
    """Write `PAGE` into a folder: moments by instant, and a view from the middle for browsers without 3D."""
    cameras: dict[str, View] = {}
    for moment in moments.values():
        cameras |= {camera: seen.view for camera, seen in moment.items()}
    first = next(iter(moments.values()))
    width, height = next(iter(cameras.values())).width, next(iter(cameras.values())).height
    frame = frame_of(cameras, find_subject(first))
    still = render(frame.view(frame.place(0, 0), width, height), first).colours
    data = {
        "width": width,
        "height": height,
        "edge": EDGE,
        "tolerance": TOLERANCE,
        "held": HELD,
        "step_ms": period_ns / 1e6,
        "path": _path(frame, moments),
        "cameras": {camera: _camera(view) for camera, view in cameras.items()},
        "instants": [
            {"instant": k, "cameras": [_seen(camera, seen) for camera, seen in moment.items()]}
            for k, moment in moments.items()
        ],
    }
    instants = f", {len(moments)} instants" if len(moments) > 1 else f", instant {next(iter(moments))}"
    page = Environment(autoescape=True, undefined=StrictUndefined).from_string(
        (TEMPLATES / PAGE).read_text(encoding="utf-8")
    )
    text = page.render(
        title=f"{name}{instants}",
        words=f"{count(len(cameras), 'camera')}. Drag, pinch or use the arrow keys to walk round.",
        width=width,
        height=height,
        still=_address(still, ".jpg"),
        moments=_Html(json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")),
        script=_Html((TEMPLATES / "walk.js").read_text(encoding="utf-8")),
    )
    (out / PAGE).write_text(text, encoding="utf-8")


class _Html(str):
    """Text that is HTML already."""

    __slots__ = ()

    def __html__(self) -> str:
        return self


def _path(frame: Frame, moments: Mapping[int, Moment]) -> dict[str, Any]:
    known = [seen.depth[seen.depth > 0] for moment in moments.values() for seen in moment.values()]
    nearest, farthest = min(float(one.min()) for one in known), max(float(one.max()) for one in known)
    return {
        **{key: np.asarray(value).tolist() for key, value in frame._asdict().items()},
        "near": nearest / 4,
        "far": farthest * 4,
    }


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
        share = (1 / small - 1 / far) / (1 / near - 1 / far)
    level = np.where(small > 0, 1 + np.rint(np.clip(share, 0, 1) * LEVELS), 0).astype(np.uint16)
    # Red has the upper eight bits, green the lower four.
    packed = np.stack([np.zeros_like(level), (level & 15) << 4, level >> 4], axis=2).astype(np.uint8)
    picture = seen.resized(PICTURE_PX).colours
    return {
        "camera": camera,
        "near": near,
        "far": far,
        "picture": _address(picture, ".jpg"),
        "depth": _address(packed, ".png"),
    }


def _address(picture: Array, suffix: str) -> str:
    parameters: Sequence[int] = [cv2.IMWRITE_JPEG_QUALITY, QUALITY] if suffix == ".jpg" else []
    data = cv2.imencode(suffix, picture, parameters)[1].tobytes()
    kind = "jpeg" if suffix == ".jpg" else "png"
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
