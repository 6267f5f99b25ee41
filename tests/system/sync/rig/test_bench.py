"""Frame durations, groups that can only restart, and the panel's pictures, in stepped time."""

import numpy as np

from benchmarks.simulated.panel_photographs import difference_ns, read_time
from capture_app.companions.panel.panel_photograph import CYCLE_NS, render


def test_panel_images_show_their_time_to_microseconds() -> None:
    rng = np.random.default_rng(4)
    for row_time_ns in (10_840, 12_300):
        start_ns = int(rng.integers(0, 10 * CYCLE_NS))
        picture = render(start_ns, exposure_ns=97_560, row_time_ns=row_time_ns, rng=rng, true_ppm=20.0)
        read_ns = read_time(picture, exposure_ns=97_560, row_time_ns=row_time_ns)
        assert abs(difference_ns(read_ns, start_ns % CYCLE_NS)) < 8_000
