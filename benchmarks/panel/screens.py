"""How well two cameras that look at one screen are told apart, by its refresh rate and their exposure.

Rendered photographs: `python -m benchmarks.panel.screens [--count 16]`. Each pair sees one screen from two
places, with shutters that are told; the screen's slowness and scan are the same for both.
"""

import argparse
import math
from dataclasses import replace

import numpy as np

from benchmarks.panel.photographs import draw_case
from capture_app.panel.finder import PanelNotFoundError
from capture_app.panel.pattern import nearest_ns, panel_named
from capture_app.panel.time_reading import read_panel

RATES_HZ = (60, 144)
EXPOSURES_MS = (1.0, 4.0, 12.0)
APART_MS = 40.0
"""Pairs are apart by up to this, either way."""


def pair_error(rate_hz: int, exposure_ms: float, seed: int) -> tuple[float, float] | None:
    """Error of the difference of two cameras and its 95 % error bar, ms; None where one is refused."""
    rng = np.random.default_rng([seed, rate_hz])
    panel = panel_named(f"screen-{rate_hz}hz-down")
    start_ns, apart_ns = rng.uniform(0, panel.cycle_ns), rng.uniform(-1, 1) * APART_MS * 1e6
    screen = draw_case(2 * seed, screen=True).photograph
    told, true, bars = [], [], []
    for number, begin_ns in enumerate((start_ns, start_ns + apart_ns)):
        # Corners are drawn for a panel of the same shape.
        photograph = replace(
            draw_case(2 * seed + number, screen=True).photograph,
            panel=panel,
            exposure_ns=exposure_ms * 1e6,
            response_ns=screen.response_ns,
            scan_share=screen.scan_share,
            rate_error=screen.rate_error,
        )
        try:
            read = read_panel(
                photograph.take(begin_ns, rng),
                exposure_ns=photograph.exposure_ns,
                row_time_ns=photograph.row_time_ns,
            )
        except PanelNotFoundError:
            return None
        told.append(read.middle_ns)
        true.append(begin_ns + read.row * photograph.row_time_ns)
        bars.append(read.uncertainty_ns)
    error_ns = nearest_ns((told[1] - told[0]) - (true[1] - true[0]), panel.cycle_ns)
    return error_ns / 1e6, math.hypot(*bars) / 1e6


def main() -> None:
    """Print a line for each rate and exposure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=16)
    count = parser.parse_args().count
    print("rendered photographs, seeds from 0")
    print("  screen  exposure  pairs  refused  error median   largest  bar median  in bar")
    for rate_hz in RATES_HZ:
        for exposure_ms in EXPOSURES_MS:
            found = [pair_error(rate_hz, exposure_ms, seed) for seed in range(count)]
            read = [one for one in found if one is not None]
            errors, bars = np.abs([one[0] for one in read]), np.array([one[1] for one in read])
            print(
                f"{rate_hz:5d} Hz  {exposure_ms:5.0f} ms  {len(read):5d}  {count - len(read):7d}  "
                f"{np.median(errors):9.2f} ms {errors.max():6.2f} ms  {np.median(bars):7.2f} ms  "
                f"{100 * (errors <= bars).mean():4.0f} %",
                flush=True,
            )


if __name__ == "__main__":
    main()
