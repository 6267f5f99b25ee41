"""How a panel of LEDs is wired: what each output of its shift registers drives, and the page that says so."""

from itertools import pairwise
from pathlib import Path

from capture_app.panel.pattern import COUNT, Panel
from capture_app.text import duration

TEMPLATE = Path(__file__).parent / "wiring.md"
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
    text = TEMPLATE.read_text("utf-8")
    for name, value in values.items():
        text = text.replace(f"@{name}@", str(value))
    return text
