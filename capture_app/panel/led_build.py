"""The folder of what it takes to build a panel.

The frame of an LED panel on a page to print: its markers, its dark ground, and a cross for each LED.

How a panel of LEDs is wired: what each output of its shift registers drives, and the page that says so.

The wires of a panel of LEDs as a drawing (SVG).

The folder of what it takes to build a panel of LEDs.
"""

from itertools import pairwise
from pathlib import Path

from capture_app.board.printing import Page, to_pdf, to_svg
from capture_app.panel.pattern import COUNT, MARKER_SIZE, Panel, marker_squares
from capture_app.session.files.output_folder import OutputFolder, replaces_only
from capture_app.text import duration

PITCH_MM = 10.0
"""From one LED to the next, unless something else is asked for: it suits LEDs of 5 mm."""
CROSS_MM = (4.0, 0.3)
"""Length and width of a cross's lines."""


def frame_page(panel: Panel, paper: str = "a4", pitch_mm: float = PITCH_MM) -> Page:
    """Return the page; raises BadInputError where the frame does not fit the paper."""
    size = panel.width * pitch_mm, panel.height * pitch_mm
    page = Page(paper, size, "a frame", smaller="smaller --pitch-mm")

    def placed(x: float, y: float, width: float, height: float) -> tuple[float, float, float, float]:
        return page.left + x * pitch_mm, page.top + y * pitch_mm, width * pitch_mm, height * pitch_mm

    page.black += [placed(*ground) for ground in panel.dark]
    for marker in panel.markers:
        page.black.append(placed(marker.x, marker.y, MARKER_SIZE, MARKER_SIZE))
        squares = marker_squares(marker.number)
        side = MARKER_SIZE / len(squares)
        page.white += [
            placed(marker.x + column * side, marker.y + row * side, side, side)
            for row, line in enumerate(squares)
            for column, white in enumerate(line)
            if white
        ]
    length, width = CROSS_MM
    for lamp in panel.lamps:
        x, y = page.left + lamp.x * pitch_mm, page.top + lamp.y * pitch_mm
        page.white.append((x - length / 2, y - width / 2, length, width))
        page.white.append((x - width / 2, y - length / 2, width, length))
    each = f"{duration(panel.tick_ns)} a column, LEDs {pitch_mm:g} mm apart"
    page.add_foot(
        f"simulshot panel {panel.name}: {each}",
        "Print at 100 % (not 'fit to page'). An LED goes through the middle of each cross.",
    )
    return page


WIRING_TEMPLATE = Path(__file__).parent / "build" / "wiring.md"
REGISTERS = 3
"""An array's: TPIC6B595 of Texas Instruments (SLIS032), whose outputs sink up to 150 mA each."""
DRAINS = (4, 5, 6, 7, 14, 15, 16, 17)
"""Pins of a register's outputs DRAIN0 to DRAIN7, in the package with 20 pins."""
SUPPLY_V, FORWARD_V, OHM = 5.0, 2.0, 330
"""Of the board, of a red LED, and of each LED's resistor."""


def register_letters(panel: Panel) -> str:
    """A letter for each register, in the order of the chain."""
    return "ABCDEF"[: REGISTERS * len(panel.ticks)]


def driven(register: int, drain: int) -> str | None:
    """What an output drives, counted from 1: a column, or an LED of the row; None for a spare output."""
    lamp, number = divmod(8 * (register % REGISTERS) + drain, COUNT)
    return f"{('column', 'row LED')[lamp]} {number + 1}" if lamp < 2 else None


def wiring_text(panel: Panel, pitch_mm: float) -> str:
    """The page that explains how to build it, in Markdown."""
    letters = register_letters(panel)
    led_ma = 1000 * (SUPPLY_V - FORWARD_V) / OHM
    sides = ("left ", "right ") if len(panel.ticks) > 1 else ("",)
    chain = [f"| {letters[0]} | 3 (SER IN) | board, D11 |"]
    chain += [f"| {after} | 3 (SER IN) | {before}, 18 (SER OUT) |" for before, after in pairwise(letters)]
    outputs = [
        f"| {sides[register // REGISTERS]}{what} | {letter} | DRAIN{drain} | {pin} |"
        for register, letter in enumerate(letters)
        for drain, pin in enumerate(DRAINS)
        if (what := driven(register, drain)) is not None
    ]
    lit = (
        f"{duration(panel.tick_ns * n)}{f' ({side.strip()})' * bool(side)}"
        for n, side in zip(panel.ticks, sides, strict=True)
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
    text = WIRING_TEMPLATE.read_text("utf-8")
    for name, value in values.items():
        text = text.replace(f"@{name}@", str(value))
    return text


_BUSES = (("D13", "SRCK 13", 0), ("D10", "RCK 12", 1), ("D9", "/G 9", 2))
"""Of the board's pin, the registers' pin, and the place among the buses above each line of registers."""
_WIDTH, _LEFT, _STEP, _BOX = 1000, 235, 255, 215
_LINE = 270
"""Height of a line of registers, with its buses and what its outputs go to."""


def wiring_svg(panel: Panel) -> bytes:
    """Return the drawing: the board, the chain of registers and what each output is for."""
    letters = register_letters(panel)
    lines = len(panel.ticks)
    height = 60 + _LINE * lines + 190
    parts = _board(lines)
    for number, letter in enumerate(letters):
        parts += _register(number, letter, is_last=number == len(letters) - 1)
    parts += _column(60 + _LINE * lines + 20)
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_WIDTH}" height="{height}" '
        f'viewBox="0 0 {_WIDTH} {height}" font-family="Helvetica, Arial, sans-serif" font-size="13">'
    )
    title = f"Panel {panel.name}: board and registers, with the numbers of their pins"
    ground = f'<rect width="{_WIDTH}" height="{height}" fill="#fff"/>'
    return "\n".join([head, ground, _text(20, 28, title, size=16), *parts, "</svg>\n"]).encode()


def _board(lines: int) -> list[str]:
    """The board at the left, and the buses that go from it along every line of registers."""
    parts = [_box(20, 60, 110, 200, "Uno or Nano")]
    for place, (pin, _, bus) in enumerate(_BUSES):
        y = 100 + 26 * place
        trunk = 150 + 14 * place
        parts.append(_text(124, y + 4, pin, anchor="end"))
        parts.append(_wire((130, y), (trunk, y)))
        ends = [_bus_y(line, bus) for line in range(lines)]
        parts.append(_wire((trunk, min(y, *ends)), (trunk, max(y, *ends))))
        parts += [_wire((trunk, end), (_LEFT + 2 * _STEP + 40 + 60 * bus, end)) for end in ends]
    parts += [_text(124, 204, "D11", anchor="end"), _wire((130, 200), (_LEFT, 200))]
    parts += [_text(124, 226, "5 V", anchor="end"), _text(124, 246, "GND", anchor="end")]
    notes = ("10 kΩ from D9 to 5 V", "pins 2, 8: 5 V", "pins 10, 11, 19: GND", "100 nF at each")
    parts += [_text(20, 280 + 16 * number, note, size=12) for number, note in enumerate(notes)]
    return parts


def _bus_y(line: int, bus: int) -> int:
    return 70 + 12 * bus + _LINE * line


def _register(number: int, letter: str, *, is_last: bool) -> list[str]:
    line, place = divmod(number, REGISTERS)
    left, top = _LEFT + _STEP * place, 130 + _LINE * line
    parts = [_box(left, top, _BOX, 110, f"{letter}: TPIC6B595", title_y=60)]
    for _, pin, bus in _BUSES:
        x = left + 40 + 60 * bus
        parts += [_wire((x, _bus_y(line, bus)), (x, top)), _dot(x, _bus_y(line, bus))]
        parts.append(_text(x, top + 16, pin, anchor="middle", size=11))
    parts.append(_text(left + 5, top + 74, "3", size=11))
    parts.append(_text(left + _BOX - 5, top + 74, "18", anchor="end", size=11))
    right = left + _BOX
    if place < REGISTERS - 1:
        parts.append(_wire((right, top + 70), (right + _STEP - _BOX, top + 70)))
    elif not is_last:
        below = top + _LINE
        parts.append(
            _wire((right, top + 70), (right + 20, top + 70), (right + 20, below - 75), (205, below - 75),
                  (205, below + 70), (_LEFT, below + 70))
        )  # fmt: skip
    for drain, number_of_pin in enumerate(DRAINS):
        at = left + 18 + drain * 25.5
        parts.append(_text(at, top + 104, str(number_of_pin), anchor="middle", size=11))
        what = driven(number, drain)
        if what is not None:
            parts.append(_wire((at, top + 110), (at, top + 122)))
            parts.append(_text(at + 4, top + 126, what, turned=True, size=11))
    return parts


def _column(top: int) -> list[str]:
    """What hangs on a column's output, and on one of the row's."""
    parts = [_text(20, top + 10, "What an output drives", size=14)]
    for name, left, shown in (
        ("column: ten LEDs on one output", 60, COUNT),
        ("row: one LED an output", 640, 1),
    ):
        xs = [left + 45 * n for n in range(shown)]
        up, down = top + 50, top + 140
        parts.append(_text(left - 20, top + 32, f"a {name}, each with {OHM} Ω", size=12))
        parts.append(_wire((left - 20, up), (xs[-1] + 20, up)))
        parts.append(_text(xs[-1] + 26, up + 4, "5 V"))
        for x in xs:
            parts.append(_wire((x, up), (x, down)))
            parts.append(
                f'<rect x="{x - 5}" y="{up + 10}" width="10" height="26" fill="#fff" stroke="#000"/>'
            )
            parts.append(f'<path d="M{x - 8} {up + 50}h16l-8 14z" fill="#c00"/>')
            parts.append(_wire((x - 8, up + 64), (x + 8, up + 64)))
        parts.append(_wire((xs[0], down), (xs[-1] + 20, down)))
        parts.append(_text(xs[-1] + 26, down + 4, "DRAIN"))
    return parts


def _box(left: float, top: float, width: float, height: float, title: str, *, title_y: float = 20) -> str:
    box = (
        f'<rect x="{left}" y="{top}" width="{width}" height="{height}" rx="4" fill="#f4f4f4" stroke="#000"/>'
    )
    return box + _text(left + width / 2, top + title_y, title, anchor="middle")


def _wire(*points: tuple[float, float]) -> str:
    return f'<polyline points="{" ".join(f"{x:g},{y:g}" for x, y in points)}" fill="none" stroke="#000"/>'


def _dot(x: float, y: float) -> str:
    return f'<circle cx="{x:g}" cy="{y:g}" r="3"/>'


def _text(
    x: float, y: float, text: str, *, anchor: str = "start", size: int = 13, turned: bool = False
) -> str:
    turn = f' transform="rotate(90 {x:g} {y:g})"' if turned else ""
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" font-size="{size}"{turn}>{text}</text>'


SKETCH_TEMPLATE = Path(__file__).parent / "build" / "panel.ino"
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
    text = SKETCH_TEMPLATE.read_text("utf-8")
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
