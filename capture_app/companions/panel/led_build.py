"""Build files of an LED panel: sketch, wiring and printable frame."""

from collections.abc import Mapping
from itertools import pairwise, product
from pathlib import Path

from capture_app.board.printing import Page, to_pdf, to_svg
from capture_app.common.text import duration, fill_in
from capture_app.companions.panel.pattern import COUNT, MARKER_SIZE, Panel, marker_squares
from capture_app.session.files.output_folder import OutputFolder, replaces_only

PITCH_MM = 10.0
"""Default distance between LEDs; suits 5 mm LEDs."""
CROSS_MM = (4.0, 0.3)
"""Length and width of a cross's lines."""
REGISTERS = 3
"""Shift registers per array: Texas Instruments TPIC6B595 (SLIS032), whose outputs sink up to 150 mA each."""
DRAINS = (4, 5, 6, 7, 14, 15, 16, 17)
"""Pins of outputs DRAIN0 to DRAIN7 in the 20-pin package."""
SUPPLY_V, FORWARD_V, OHM = 5.0, 2.0, 330
"""Board supply, forward voltage of a red LED, and each LED's resistor."""
SKETCH = "panel/panel.ino"
"""The Arduino tools require a sketch in a folder of the same name."""
FILES = (SKETCH, "WIRING.md", "wiring.svg", "frame.pdf", "frame.svg")


def frame_page(panel: Panel, paper: str = "a4", pitch_mm: float = PITCH_MM) -> Page:
    """Return the printable frame. Raises BadInputError if it does not fit the paper."""
    page = Page(
        paper, (panel.width * pitch_mm, panel.height * pitch_mm), "a frame", smaller="smaller --pitch-mm"
    )

    def placed(x: float, y: float, width: float, height: float) -> tuple[float, float, float, float]:
        return page.left + x * pitch_mm, page.top + y * pitch_mm, width * pitch_mm, height * pitch_mm

    page.black += [placed(*ground) for ground in panel.dark]
    for number, left, top in panel.markers:
        page.black.append(placed(left, top, MARKER_SIZE, MARKER_SIZE))
        squares = marker_squares(number)
        side = MARKER_SIZE / len(squares)
        page.white += [
            placed(left + column * side, top + row * side, side, side)
            for row, line in enumerate(squares)
            for column, white in enumerate(line)
            if white
        ]
    for lamp, (width, height) in product(panel.lamps, (CROSS_MM, CROSS_MM[::-1])):
        x, y = page.left + lamp.x * pitch_mm, page.top + lamp.y * pitch_mm
        page.white.append((x - width / 2, y - height / 2, width, height))
    page.add_foot(
        f"simulshot panel {panel.name}: {duration(panel.tick_ns)} a column, LEDs {pitch_mm:g} mm apart",
        "Print at 100 % (not 'fit to page'). An LED goes through the middle of each cross.",
    )
    return page


TEMPLATES = Path(__file__).parent / "sketch"


def driven(register: int, drain: int) -> str | None:
    """Return the load on an output, numbered from 1: a column or a row LED; None for a spare output."""
    lamp, number = divmod(8 * (register % REGISTERS) + drain, COUNT)
    return f"{('column', 'row LED')[lamp]} {number + 1}" if lamp < 2 else None


def wiring_text(panel: Panel, pitch_mm: float) -> str:
    """Return the build instructions in Markdown."""
    letters = "ABCDEF"[: REGISTERS * len(panel.ticks)]
    led_ma = 1000 * (SUPPLY_V - FORWARD_V) / OHM
    halves = ("left ", "right ") if len(panel.ticks) > 1 else ("",)
    chain = [f"| {letters[0]} | 3 (SER IN) | board, D11 |"]
    chain += [f"| {after} | 3 (SER IN) | {before}, 18 (SER OUT) |" for before, after in pairwise(letters)]
    outputs = [
        f"| {halves[register // REGISTERS]}{what} | {letter} | DRAIN{drain} | {pin} |"
        for register, letter in enumerate(letters)
        for drain, pin in enumerate(DRAINS)
        if (what := driven(register, drain)) is not None
    ]
    lit = (
        f"{duration(panel.tick_ns * n)}{f' ({side.strip()})' * bool(side)}"
        for n, side in zip(panel.ticks, halves, strict=True)
    )
    values = {
        "name": panel.name,
        "ticks": " and ".join(lit),
        "cycle": duration(panel.cycle_ns),
        "registers": len(letters),
        "leds": len(panel.lamps),
        "ohm": OHM,
        "pitch": f"{pitch_mm:g}",
        "led_ma": f"{led_ma:.0f}",
        "column_ma": f"{COUNT * led_ma:.0f}",
        "all_ma": f"{len(panel.ticks) * (COUNT + 1) * led_ma:.0f}",
        "chain": "\n".join(chain),
        "outputs": "\n".join(outputs),
        "tick_us": f"{panel.tick_ns / 1000:.0f}",
    }
    return _filled("wiring.md.template", values)


def _filled(template: str, values: Mapping[str, object]) -> str:
    return fill_in((TEMPLATES / template).read_text("utf-8"), values)


def write_sketch(panel: Panel, out: Path, *, paper: str, pitch_mm: float) -> tuple[Path, ...]:
    """Write an LED panel's Arduino sketch, wiring guide and printable frame into `out`; return their paths.

    All files are written or none. Raises BadInputError if the frame does not fit the paper, or if `out`
    contains other files.
    """
    frame = frame_page(panel, paper, pitch_mm)
    program = {
        "name": panel.name,
        "tick_us": f"{panel.tick_ns / 1000:.0f}",
        "arrays": str(len(panel.ticks)),
        "ticks": ", ".join(str(ticks) for ticks in panel.ticks),
    }
    made = {
        SKETCH: _filled("panel.ino", program).encode(),
        "WIRING.md": wiring_text(panel, pitch_mm).encode(),
        "wiring.svg": _filled(f"wiring-{len(panel.ticks)}.svg", {"name": panel.name}).encode(),
        "frame.pdf": to_pdf(frame),
        "frame.svg": to_svg(frame),
    }
    with OutputFolder(out, replaces_only({name.partition("/")[0] for name in FILES})) as output:
        for name in FILES:
            path = output.folder / name
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(made[name])
    return tuple(output.target / name for name in FILES)
