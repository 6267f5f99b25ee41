"""Single steps of time offsets, each against a value that can be worked out by hand."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from capture_app.session.format.manifest import CameraRecord
from reconstruction.common.geometry import Array
from reconstruction.scene.dataset import Dataset
from reconstruction.time_offsets.camera_time import ImageTimes
from reconstruction.time_offsets.crossings import Crossings, OffsetFit, _fit
from reconstruction.time_offsets.lamp import BlinkEdge, find_edge_time
from reconstruction.time_offsets.pair_geometry import geometry_terms
from reconstruction.time_offsets.pair_offset import PairOffsets
from reconstruction.time_offsets.rough_offset import find_rough_offset, measure_activity, rough_offsets_ms
from tests.facts import make_facts
from tests.unit.reconstruction.time_offsets.test_offset_fit import NOTHING_STILL
from tests.unit.reconstruction.time_offsets.test_pair_geometry import A, B, seen
from tests.unit.reconstruction.time_offsets.test_repetition import PERIOD_MS, Film, walker

WIDTH_MS, ROW_MS, FIRST_MS = 10.0, 0.05, 100.0


def test_an_edge_is_of_the_row_whose_exposure_it_halves() -> None:
    rows = np.arange(480)
    times_ms = FIRST_MS + ROW_MS * rows
    at = times_ms[200]
    lit = np.clip((times_ms - at) / WIDTH_MS + 0.5, 0, 1)
    edge = BlinkEdge(True, rows.astype(float), times_ms, lit, np.full(480, 0.01))
    found = find_edge_time(edge, (WIDTH_MS, 1.0))
    assert found is not None
    assert found[0] == pytest.approx(at, abs=0.05)
    assert found[1] == pytest.approx(200, abs=2)


@pytest.mark.parametrize("late_ms", [-700.0, 0.0, 450.0])
def test_bursts_of_motion_tell_roughly_how_late_a_camera_is(late_ms: float) -> None:
    rng = np.random.default_rng(4)
    scene_ms, busy = np.arange(-3000.0, 12000.0, 20.0), rng.uniform(0, 1, 750)
    busy = np.convolve(busy, np.hanning(9), "same") ** 4

    def activity(start_ms: float, late_ms: float) -> tuple[Array, Array]:
        """What a camera shows from a time of its own on; late by that, it shows what was before."""
        times_ms = np.arange(start_ms, start_ms + 8000.0, 33.0)
        return times_ms, np.interp(times_ms + late_ms, scene_ms, busy)

    first, second = activity(40.0, 0.0), activity(160.0, late_ms)
    assert rough_offsets_ms(first, second, 33.0)[0] == pytest.approx(late_ms, abs=25)


def test_activity_is_what_moves_and_not_a_light_that_is_switched_on() -> None:
    """Between images of which one is missing, motion counts by the time that it took."""
    places = {0: 10, 1: 10, 2: 30, 3: 50, 5: 90, 6: 90}

    def grey(_: str, instant: int) -> Array:
        image = np.full((120, 160), 60 if instant < 6 else 140, np.uint8)
        image[40:80, places[instant] : places[instant] + 20] += 80
        return image

    dataset: Any = SimpleNamespace(
        instants=lambda _: [*places],
        grey=grey,
        instants_ns=[7_000_000],
        record=lambda _, k: SimpleNamespace(leader_ns=7_000_000 + 20_000_000 * k),
    )
    times_ms, changes = measure_activity(dataset, "a")
    assert times_ms.tolist() == [10, 30, 50, 80, 110]
    moved = 80 * 2 * 20 * 40 / (120 * 160) / 20
    assert changes == pytest.approx([0, moved, moved, moved / 2, 0], abs=1e-3)


@pytest.mark.parametrize("mains", [0.0, 0.25])
def test_points_are_followed_through_bands_of_mains_light(mains: float) -> None:
    class Banded(Film):
        period_ns = round(PERIOD_MS * 1e6)

        def has_image(self, camera: str, instant: int) -> bool:
            return True

        def grey(self, camera: str, instant: int) -> Array:
            rows = np.arange(120)[:, None]
            light = 1 + mains * np.sin(2 * np.pi * (rows / 50 + instant / 3))
            return np.asarray(np.clip(0.7 * light * super().grey(camera, instant), 0, 255), np.uint8)

    finder = PairOffsets.__new__(PairOffsets)
    finder.dataset, finder.repeated = cast("Dataset", Banded(walker)), {"a": ()}.__getitem__
    before, at, after = finder._find_points("a", 5, all_moves=True)[1]
    assert np.isfinite(after - before).all(axis=1).mean() > 0.6
    moves = (np.abs(at - (120, 60)) < (16, 36)).all(axis=1)
    assert np.nanmedian((after - before)[moves], axis=0) == pytest.approx([4, 0], abs=0.3)


def test_an_offset_at_which_the_recordings_do_not_overlap_is_not_a_rival() -> None:
    times_ms = np.arange(0.0, 2000.0, 33.0)
    activity = times_ms, np.random.default_rng(4).uniform(0.1, 1, len(times_ms))

    def measure(limit: int, *, rough: tuple[float, float], **_: Any) -> OffsetFit:
        """Return votes at 0 ms only, and no examined instants at delays above a second."""
        late_ms = rough[0]
        examined = tuple(range(limit)) if abs(late_ms) <= 1000 else ()
        return OffsetFit(late_ms, 0.5, votes=20.0 * (abs(late_ms) < 33), unvoted=examined)

    found = find_rough_offset(measure, activity, activity, 1000.0, 33.0)
    assert not isinstance(found, str), found
    assert found[0] == pytest.approx(0, abs=1)


def test_the_bottom_of_a_reduced_image_has_the_time_of_the_sensors_bottom() -> None:
    camera = CameraRecord(name="a", facts=make_facts(width=640, height=480, row_time_ns=50_000))
    record = SimpleNamespace(leader_ns=0, exposure_start_ns=0, exposure_ns=4_000_000)
    for height in (480, 120):
        dataset = SimpleNamespace(
            instants_ns=(0,),
            instants=lambda camera: (0,),
            record=lambda camera, instant: record,
            session=SimpleNamespace(camera=lambda name: camera),
            size=lambda camera, height=height: (height * 4 // 3, height),
        )
        times = ImageTimes(cast(Dataset, dataset), ("a",))
        assert times.of_rows_ms("a", 0, np.array([0, height])) == pytest.approx([2.0, 2.0 + 480 * 0.05])


def test_errors_that_neighbouring_instants_share_count_by_newey_and_west() -> None:
    """Runs of four: of the lags 1 and 2, a half and none of the variance, at weights of 2/3 and 1/3."""

    def sd_ms(signs: Array) -> float:
        instants = np.repeat(np.arange(len(signs)), 12)
        speed = np.tile([0.5, -0.5], len(instants) // 2)
        late_ms = 2.0 * signs[instants]
        geometry = geometry_terms(A, B, *seen((1.5, 6.0), len(instants), seed=1))
        one, none = np.ones(len(instants)), np.zeros(len(instants))
        return _fit(
            Crossings(instants, late_ms, speed, one, none, geometry, instants), NOTHING_STILL, 1.0
        ).sd_ms

    fours, twos = np.tile([1, 1, 1, 1, -1, -1, -1, -1], 5), np.tile([1, 1, -1, -1], 10)
    assert sd_ms(fours) / sd_ms(twos) == pytest.approx((1 + 2 / 3) ** 0.5, abs=0.1)
