"""The burst's part of a report: its pictures as a grid, cameras by instants."""

import base64
from html import escape
from pathlib import Path

import cv2
import numpy as np

from capture_app.errors import BadInputError
from reconstruction.report import wording
from reconstruction.scores.compare_results import BurstGrid

KINDS = {b"\x89PNG\r\n\x1a\n": "image/png", b"\xff\xd8\xff": "image/jpeg"}


def burst_section(burst: BurstGrid | None, out: Path) -> str:
    """The grid; nothing where there is none. Raises BadInputError where a picture is missing."""
    if burst is None:
        return ""
    rows = [
        "<tr><td></td>"
        + "".join(f'<th scope="col">{escape(wording.milliseconds(round(ms)))}</th>' for ms in burst.times_ms)
        + "</tr>"
    ]
    for camera, row in zip(burst.cameras, burst.thumbnails, strict=True):
        cells = []
        for instant, path in zip(burst.instants, row, strict=True):
            if not path:
                cells.append("<td>none</td>")
                continue
            data, (wide, high) = embed(out / path)
            label = escape(f"{camera}, instant {instant}")
            cells.append(
                f'<td><img alt="{label}" title="{label}" width="{wide}" height="{high}" src="{data}"></td>'
            )
        rows.append(f'<tr><th scope="row">{escape(camera)}</th>{"".join(cells)}</tr>')
    return f"""<section aria-labelledby="burst">
<h2 id="burst">The burst</h2>
<p>Each row is a camera, each column an instant. Synchronized pictures come from one column; an offset takes
one camera's picture from a column further right.</p>
<div class="wide" role="region" aria-label="Pictures of the burst">
<table class="burst">{"".join(rows)}</table></div>
</section>"""


def embed(path: Path) -> tuple[str, tuple[int, int]]:
    """A picture as an address that holds it, and its width and height, px."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BadInputError(
            f"the report lacks the picture {path}: {error.strerror or error}",
            hint="compare the session again",
        ) from error
    kind = next((kind for magic, kind in KINDS.items() if data.startswith(magic)), None)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if kind else None
    if image is None:
        raise BadInputError(
            f"the picture {path} is not a readable PNG or JPEG", hint="compare the session again"
        )
    return f"data:{kind};base64,{base64.b64encode(data).decode()}", (image.shape[1], image.shape[0])
