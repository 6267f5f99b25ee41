"""Render a page from the templates: one HTML file with style, script and pictures inside, small to send."""

import base64
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from capture_app.errors import BadInputError
from capture_app.session.files.durable import PART, write_atomic
from capture_app.text import count
from reconstruction.common.geometry import Array
from reconstruction.report import wording

TEMPLATES = "template"
METRICS = "metrics.json"
REPORT = "report.html"
PNG, JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"
QUALITY = 74
"""The quality of photographs, as WebP."""
LOSSLESS = 101
"""OpenCV's word for a WebP without loss: flat colours and hard edges stay as they are."""
MAX_PANEL_PX = 1024
"""What is wider is made smaller: no page shows more."""
FILTERS = (
    count, wording.lateness, wording.microseconds, wording.milliseconds, wording.number, wording.quantity,
    wording.seconds, wording.share, wording.keep_units, wording.timeliness, wording.walking_distance,
)  # fmt: skip


@dataclass(frozen=True)
class Section:
    """One section of a page: its template, and its anchor and title where the contents list it."""

    template: str
    anchor: str = ""
    title: str = ""


def render_page(
    view: Mapping[str, object], sections: Sequence[Section], package: str = "reconstruction.report"
) -> str:
    """Render the page's frame around its sections, whose templates read `view`.

    The frame itself shows the view's `title`, `kicker` and `name`, and its `verdict`: a headline and what
    follows it. It may have `opening`, the template of what stands below the headline; `kind`, a word on
    where the pictures come from; and `numbers_in`, the files beside the page that hold its numbers. The
    sections' templates are those of `package`, then the report's.
    """
    headline, lead = wording.headline(str(view["verdict"]))
    frame = {"opening": "", "kind": "", "numbers_in": (METRICS,), "cloud": None}
    page = _environment(package).get_template("page.html")
    return page.render({**frame, **view, "headline": headline, "lead": lead, "sections": sections})


def write_page(page: str, out: Path) -> Path:
    """Write `report.html` into the folder `out`, whole or not at all, and return its path.

    Raises:
        BadInputError: it cannot be written.
    """
    target = out / REPORT
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_atomic(target, page.encode("utf-8", "replace"))
    except OSError as error:
        with suppress(OSError):
            target.with_name(target.name + PART).unlink()
        raise BadInputError(
            f"cannot write the report {target}: {error.strerror or error}",
            hint="choose another folder with --out",
        ) from error
    return target


@cache
def _environment(package: str) -> Environment:
    packages = dict.fromkeys((package, "reconstruction.report"))
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(one, TEMPLATES) for one in packages]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update({one.__name__: one for one in FILTERS})
    return environment


@dataclass(frozen=True)
class EmbeddedImage:
    """A picture as a `data:` address, and its size, px."""

    address: str
    width: int
    height: int


def embed_image(path: Path, panels: int = 1, most_px: int = MAX_PANEL_PX) -> EmbeddedImage:
    """Read a PNG or JPEG and pack it for a page, each of its `panels` side by side `most_px` wide at most.

    Raises:
        BadInputError: the file is missing, or is no PNG or JPEG.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BadInputError(
            f"the report lacks the picture {path}: {error.strerror or error}",
            hint="compare the session again",
        ) from error
    known = data.startswith((PNG, JPEG))
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if known else None
    if image is None:
        raise BadInputError(
            f"the picture {path} is not a readable PNG or JPEG", hint="compare the session again"
        )
    shown = _shrink(image, most_px * panels)
    quality = LOSSLESS if data.startswith(PNG) else QUALITY
    _, packed = cv2.imencode(".webp", shown, [cv2.IMWRITE_WEBP_QUALITY, quality])
    address = f"data:image/webp;base64,{base64.b64encode(packed.tobytes()).decode()}"
    return EmbeddedImage(address, width=shown.shape[1], height=shown.shape[0])


def _shrink(image: Array, most: int) -> Array:
    height, width = image.shape[:2]
    if width <= most:
        return np.asarray(image)
    size = (most, max(1, round(height * most / width)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
