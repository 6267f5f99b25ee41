"""Web page that draws a screen panel at any refresh rate."""

import base64
import hashlib
from pathlib import Path
from typing import Any

import msgspec

from capture_app.common.text import fill_in
from capture_app.companions.panel.cycle_code import (
    CHECK_BITS,
    CHECK_POLYNOMIAL,
    CYCLE_BITS,
    PAGE_BITS,
    cell_places,
)
from capture_app.companions.panel.pattern import (
    PANELS,
    RATE_TOLERANCE,
    SCAN_FRACTION,
    marker_squares,
)

HERE = Path(__file__).parent / "page"
SCRIPTS = ("counter.js", "drawing.js", "page.js")
DEFAULT_PORT = 8010


def page_html() -> bytes:
    """Return the complete page; its content security policy allows only its own script and style."""
    script = '"use strict";\n' + "".join((HERE / name).read_text("utf-8") for name in SCRIPTS)
    style = (HERE / "page.css").read_text("utf-8")
    parts = {
        "policy": _policy(script, style),
        "style": style,
        "script": script,
        # A closing script tag must not appear in the script's text.
        "panels": msgspec.json.encode(_panels()).decode().replace("<", "\\u003c"),
    }
    return fill_in((HERE / "page.html").read_text("utf-8"), parts).encode()


def _policy(script: str, style: str) -> str:
    digests = (hashlib.sha256(text.encode()).digest() for text in (script, style))
    allowed = "script-src 'sha256-{}'; style-src 'sha256-{}'; img-src data:".format(
        *(base64.b64encode(digest).decode() for digest in digests)
    )
    return f"default-src 'none'; {allowed}; base-uri 'none'; form-action 'none'"


def _panels() -> dict[str, Any]:
    """Return the layout shared by all screen panels, and the values that differ between them."""
    screens = [panel for panel in PANELS.values() if panel.is_screen]
    layout = screens[0].description()
    layout["markers"] = [{"x": marker["x"], "y": marker["y"]} for marker in layout["markers"]]
    fields = ("width", "height", "cycle_ticks", "marker_size", "markers", "dark", "lamp_size", "lamps")
    return {
        "scan_share": SCAN_FRACTION,
        "layout": {key: layout[key] for key in fields}
        | {"rate_tolerance": RATE_TOLERANCE, "cells": cell_places(screens[0])}
        | {"turn_bits": CYCLE_BITS, "page_bits": PAGE_BITS}
        | {"check_bits": CHECK_BITS, "check_polynomial": CHECK_POLYNOMIAL},
        "screens": [
            {
                "name": panel.name,
                "rate_hz": round(1e9 / panel.tick_ns),
                "scan": panel.scan,
                "markers": [
                    "".join(str(white) for row in marker_squares(number) for white in row)
                    for number, _, _ in panel.markers
                ],
            }
            for panel in screens
        ],
    }
