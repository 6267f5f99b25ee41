"""A page to walk round in: one HTML file for any browser with WebGL 2, with a script that draws moments."""

import base64
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from markupsafe import Markup

from capture_app.common.walk import WALK
from reconstruction.common.camera_paths import Frame
from reconstruction.common.geometry import Array, View
from reconstruction.common.templates import environment_of

PACKAGE, TEMPLATE = "reconstruction.pages", "walk.html"
TEMPLATES = Path(__file__).with_name("template")
QUALITY = 85
BEYOND = 1.3
"""How far the eye goes, in halves of the extent that the cameras saw."""


class Drawing(NamedTuple):
    """Moments, and the script that draws them."""

    script: Path
    instants: Sequence[Mapping[str, Any]]
    """Each with its number as `instant`."""
    facts: Mapping[str, Any]
    """What else the script reads; `held` is how many instants stay in the GPU's memory."""
    legend: str = ""
    """What the drawing's marks mean, for people."""


def path_of(
    frame: Frame,
    depths: tuple[float, float],
    views: Mapping[str, View],
    limits: tuple[float, float] = (BEYOND, BEYOND),
) -> dict[str, Any]:
    """Return the places to look from, as `walk.js` reads them.

    `depths` are the nearest and the farthest depth. `limits` say how far the eye goes to either side and up
    and down, in halves of the frame's extent.
    """
    first = next(iter(views.values()))
    return {
        **{key: np.asarray(value).tolist() for key, value in frame._asdict().items()},
        "near": depths[0] / 4,
        "far": depths[1] * 4,
        "shape": first.width / first.height,
        "limits": limits,
    }


def write_walk_page(
    page: Path,
    name: str,
    *,
    path: Mapping[str, Any],
    views: Mapping[str, View],
    still: Array,
    period_ns: int,
    drawing: Drawing,
) -> None:
    """Write the page as a file.

    `path` has the places to look from, see `path_of`. `still` is the picture for browsers without 3D.
    """
    first, instants = next(iter(views.values())), drawing.instants
    data = {
        **drawing.facts,
        "step_ms": period_ns / 1e6,
        "path": path,
        "instants": instants,
    }
    scripts = (drawing.script, WALK, TEMPLATES / "moments.js")
    text = (
        environment_of(PACKAGE)
        .get_template(TEMPLATE)
        .render(
            name=name,
            cameras=len(views),
            instants=instants,
            legend=drawing.legend,
            width=first.width,
            height=first.height,
            still=image_address(still, ".jpg"),
            moments=Markup(json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")),  # noqa: S704 - escaped
            scripts=[Markup(script.read_text(encoding="utf-8")) for script in scripts],  # noqa: S704 - our own
        )
    )
    page.write_text(text, encoding="utf-8")


def image_address(picture: Array, suffix: str) -> str:
    """Return the `data:` address of a picture (BGR uint8) as .jpg or .png."""
    parameters: Sequence[int] = [cv2.IMWRITE_JPEG_QUALITY, QUALITY] if suffix == ".jpg" else []
    data = cv2.imencode(suffix, picture, parameters)[1].tobytes()
    kind = "jpeg" if suffix == ".jpg" else "png"
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
