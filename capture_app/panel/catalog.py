"""Which panels there are; a panel's markers say which it is, so that nobody has to describe it."""

from collections.abc import Iterator

from capture_app.errors import BadInputError
from capture_app.panel.pattern import Panel, Scan

RATES_HZ = (30, 50, 60, 72, 75, 90, 100, 120, 144, 165, 240)
"""Refresh rates of screens that markers can tell."""
RATE_TOLERANCE = 0.03
"""A screen's rate may differ by this share from the one its markers tell (59.94 Hz is 60)."""
_FIRST_MARKER = 50
"""Those below are on the usual calibration board, which may stand in the same picture."""
_MARKERS = 4
_LED_KINDS = 6
"""Room for panels of LEDs before those of screens."""


def _led_panels() -> Iterator[Panel]:
    kinds = (
        ("led-200us", 200_000.0, (1,)),
        ("led-10ms", 10_000_000.0, (1,)),
        ("led-pair", 200_000.0, (1, 50)),
    )
    for kind, (name, tick_ns, ticks) in enumerate(kinds):
        yield Panel(name, tick_ns, _FIRST_MARKER + _MARKERS * kind, ticks)


def _screen_panels() -> Iterator[Panel]:
    kind = _LED_KINDS
    for rate_hz in RATES_HZ:
        for scan in (Scan.DOWN, Scan.RIGHT, Scan.UP, Scan.LEFT):
            name = f"screen-{rate_hz}hz-{scan}"
            yield Panel(name, 1e9 / rate_hz, _FIRST_MARKER + _MARKERS * kind, (1,), 2, scan)
            kind += 1


PANELS = {panel.name: panel for panel in (*_led_panels(), *_screen_panels())}
"""All panels by their names: the paper's with ticks of 200 us or 10 ms, both side by side, and screens'."""

_BY_MARKER = {marker.number: panel for panel in PANELS.values() for marker in panel.markers}


def panel_of_marker(number: int) -> Panel | None:
    """The panel that a marker belongs to; None for markers of no panel."""
    return _BY_MARKER.get(number)


def panel_named(name: str) -> Panel:
    """The panel of that name; raises BadInputError for none."""
    if name not in PANELS:
        raise BadInputError(f"there is no panel {name!r}", hint=f"such as {', '.join(list(PANELS)[:3])}")
    return PANELS[name]


def screen_panel(rate_hz: float, scan: Scan = Scan.DOWN) -> Panel:
    """The panel for a screen of about that refresh rate; raises BadInputError for a rate that has none."""
    nearest = min(RATES_HZ, key=lambda known: abs(known / rate_hz - 1))
    if abs(nearest / rate_hz - 1) > RATE_TOLERANCE or scan is Scan.NONE:
        known = ", ".join(str(rate) for rate in RATES_HZ)
        raise BadInputError(f"no panel is drawn at {rate_hz:g} Hz", hint=f"rates of screens: {known} Hz")
    return PANELS[f"screen-{nearest}hz-{scan}"]
