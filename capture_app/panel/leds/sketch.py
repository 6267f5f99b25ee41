"""The folder of what it takes to build a panel of LEDs."""

from pathlib import Path

from capture_app.board.page import to_pdf, to_svg
from capture_app.panel.leds.diagram import wiring_svg
from capture_app.panel.leds.frame import frame_page
from capture_app.panel.leds.wiring import wiring_text
from capture_app.panel.pattern import Panel
from capture_app.session.files.output_folder import OutputFolder, replaces_only

TEMPLATE = Path(__file__).parent / "panel.ino"
SKETCH = "panel/panel.ino"
"""Arduino's programs want a sketch in a folder of its name."""
FILES = (SKETCH, "WIRING.md", "wiring.svg", "frame.pdf", "frame.svg")


def sketch_text(panel: Panel) -> str:
    """Return the program of a panel's board."""
    parts = {
        "name": panel.name,
        "tick_us": f"{panel.tick_ns / 1000:.0f}",
        "arrays": str(len(panel.ticks)),
        "ticks": ", ".join(str(ticks) for ticks in panel.ticks),
    }
    text = TEMPLATE.read_text("utf-8")
    for name, value in parts.items():
        text = text.replace(f"@{name}@", value)
    return text


def write_sketch(panel: Panel, out: Path, *, paper: str, pitch_mm: float) -> tuple[Path, ...]:
    """Write FILES into the folder `out`, whole or not at all, and return their paths.

    Raises BadInputError where the frame does not fit the paper, or `out` holds other files.
    """
    frame = frame_page(panel, paper, pitch_mm)
    made = {
        SKETCH: sketch_text(panel).encode(),
        "WIRING.md": wiring_text(panel, pitch_mm).encode(),
        "wiring.svg": wiring_svg(panel),
        "frame.pdf": to_pdf(frame),
        "frame.svg": to_svg(frame),
    }
    with OutputFolder(out, replaces_only({name.partition("/")[0] for name in FILES})) as output:
        for name in FILES:
            path = output.folder / name
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(made[name])
    return tuple(output.target / name for name in FILES)
