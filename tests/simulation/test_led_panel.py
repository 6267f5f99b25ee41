"""The panel shows the time: it can be read from a picture, to a fraction of `tau`."""

import numpy as np
import pytest

from capture_app.simulation.led_panel import COLUMNS, VIEWS, PanelView, lit_share
from capture_app.simulation.pictures import LED_PANEL, open_picture_source
from capture_app.simulation.sensor import SensorFrame

TAU_NS, EXPOSURE_NS, ROW_NS = 200_000, 100_000, 10_000


def frame(start_ns: int) -> SensorFrame:
    return SensorFrame(
        sequence=0,
        stream=0,
        start_true_ns=start_ns,
        timestamp_true_ns=start_ns,
        readout_end_true_ns=start_ns,
        exposure_ns=EXPOSURE_NS,
        dropped=False,
    )


def read_ns(view: PanelView, picture: np.ndarray) -> list[int]:
    """The frame's start modulo ten tau, by each picture row that sees one column give way to the next."""
    red = picture[..., 2].astype(float)
    found = []
    for centres in view.led_centres()[:-1]:
        middle = round(float(centres[:, 1].mean()))
        for row in range(middle - 6, middle + 7):
            columns = np.rint(centres[:, 0]).astype(int)
            light = np.array([red[row, c - 2 : c + 3].mean() for c in columns])
            share = (light - np.median(light)) / 226.0
            last = int(np.argmax(np.minimum(share, np.roll(share, -1))))
            after = share[(last + 1) % COLUMNS]
            if min(share[last], after) > 0.15:
                # The next column was lit for the exposure's last part.
                changed_ns = (last + 1) * TAU_NS
                start_ns = changed_ns - round((1 - after) * EXPOSURE_NS) - row * ROW_NS
                found.append(start_ns % (COLUMNS * TAU_NS))
    return found


@pytest.mark.parametrize("start_ns", [0, 12_345_678, 987_654_321_012])
def test_the_time_can_be_read_to_a_few_microseconds(start_ns: int) -> None:
    view = PanelView(tau_ns=TAU_NS, row_time_ns=ROW_NS)
    found = read_ns(view, view.render(frame(start_ns), seed=1))
    assert len(found) > 20
    period_ns = COLUMNS * TAU_NS
    errors = [(one - start_ns + period_ns // 2) % period_ns - period_ns // 2 for one in found]
    assert abs(np.median(errors)) < 2_000


def test_each_led_is_lit_a_tenth_of_the_time() -> None:
    starts = np.arange(0, 100 * TAU_NS, 50_000, dtype=np.int64)
    share = lit_share(starts, 50_000, TAU_NS)
    assert np.allclose(share.mean(axis=0), 0.1)
    assert np.allclose(share.reshape(len(starts), 2, COLUMNS).sum(axis=2), 1)  # always one of each ten
    assert (share[:, 0] > 0.99).sum() == 4 * 10


def test_an_exposure_over_two_columns_is_shared_between_them() -> None:
    share = lit_share(np.array([3 * TAU_NS - 30_000]), 100_000, TAU_NS)[0]
    assert share[2] == pytest.approx(0.3)
    assert share[3] == pytest.approx(0.7)
    assert share[10] == 1


def test_pictures_are_a_function_of_their_frame() -> None:
    view = PanelView()
    assert np.array_equal(view.render(frame(5), seed=1), view.render(frame(5), seed=1))
    assert not np.array_equal(view.render(frame(5), seed=1), view.render(frame(5), seed=2))
    small = PanelView(scale=0.5)
    assert small.render(frame(5), seed=1).shape == (240, 320, 3)


def test_simulated_cameras_see_the_panel_by_their_names() -> None:
    sources = [
        open_picture_source(LED_PANEL, "", camera=name, width=1, height=1, row_time_ns=ROW_NS)
        for name in VIEWS
    ]
    first, second = (source.render(frame(5), seed=1) for source in sources)
    assert not np.array_equal(first, second)
    assert sources[0].calibration is None
    assert not sources[0].ground_truth(frame(5))[2].any()
