"""Parts of what times a lamp: its edges, the ramp that they share, and which are the same."""

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from reconstruction.common.geometry import Array
from reconstruction.scene.dataset import Dataset
from reconstruction.time_offsets import lamp
from reconstruction.time_offsets.lamp import (
    NO_LAMP,
    BlinkEdge,
    SeenLamp,
    find_blink_edges,
    find_edge_time,
    fit_ramp,
    measure_light_offsets,
    see_lamp,
)

FACTS = SimpleNamespace(row_time_ns=50_000, height=480)


def film(levels: Sequence[float], rows: int = 8, columns: int = 16) -> Dataset:
    """A camera's images of even brightness every 33 ms, whose rows' times are not recorded."""
    images = {k: np.full((rows, columns), level, np.uint8) for k, level in enumerate(levels)}
    times = SimpleNamespace(
        instants=lambda camera: tuple(images),
        grey=lambda camera, k: images[k],
        size=lambda camera: (columns, rows),
        record=lambda camera, k: SimpleNamespace(
            leader_ns=33_000_000 * k, exposure_ns=None, exposure_start_ns=None
        ),
        instants_ns=(0,),
        period_ns=33_000_000,
        cameras=("a",),
        session=SimpleNamespace(camera=lambda camera: SimpleNamespace(facts=FACTS)),
    )
    return cast("Dataset", times)


def blinks(levels: Sequence[float]) -> list[tuple[bool, list[int]]]:
    """Whether each edge rises, and the images that show it."""
    rows_ms = {k: 33.0 * k + np.arange(8) for k in range(len(levels))}
    edges = find_blink_edges(film(levels), "a", rows_ms)
    return [(edge.rising, sorted({int(ms // 33) for ms in edge.times_ms})) for edge in edges]


def test_each_switching_shows_in_the_image_it_falls_into_and_beside_it() -> None:
    levels = [40] * 10 + [100] * 10 + [40] * 10
    levels[10] = 70
    assert blinks(levels) == [(True, [9, 10, 11]), (False, [18, 19, 20])]
    assert blinks([40] * 30) == []
    # Of fewer than eight images not all have others to be compared with.
    assert blinks([40] * 3 + [100] * 4) == []
    # At an end of the take, what was before or after it is not known.
    assert blinks([40] * 2 + [100] * 28) == []
    assert blinks([40] * 4 + [100] * 26) == [(True, [2, 3, 4])]
    assert blinks([40] * 29 + [100]) == []
    assert blinks([40] * 4 + [100] * 4) == [(True, [2, 3, 4])]
    # Of small changes that never end, none is a lamp's.
    assert blinks([40 + 30 * (k % 2) for k in range(30)]) == []
    assert blinks([100] * 15 + [101] * 15) == []


def test_levels_between_dark_and_bright_have_errors() -> None:
    """What moves before a row does not count, nor white pixels, nor rows that hardly differ."""
    dark = np.full((4, 40), 40.0, np.float32)
    rise = np.full((4, 40), 60.0, np.float32)
    usable = np.ones((4, 40), bool)
    usable[2, 11:] = usable[3, 12:] = False
    image = dark + np.array([[15.0], [30], [30], [30]])
    image[0, :8] = 200
    lit, sd = lamp._lit_rows(image.astype(np.uint8), dark, rise, usable)
    assert lit[[0, 1, 3]] == pytest.approx([0.25, 0.5, 0.5])
    assert np.isnan(lit[2])
    assert np.isnan(sd[2])
    assert sd[1] == pytest.approx(np.hypot(0.01, 1 / np.sqrt(40 * 60**2)))
    assert sd[3] > sd[1]
    # Unequal pixels are weighted by how much they differ.
    rise[1, :20] = 20
    image[1] = dark[1] + 0.5 * rise[1]
    image[1, :20] += 1
    lit, _ = lamp._lit_rows(np.rint(image).astype(np.uint8), dark, rise, usable)
    assert lit[1] == pytest.approx((20 * 11 * 20 + 60 * 30 * 20) / (20**2 * 20 + 60**2 * 20), abs=2e-3)


def ramp_edge(at_ms: float, width_ms: float, bend: float = 1.0, *, rising: bool = True) -> BlinkEdge:
    """The rows of three images of 200 rows, 0.1 ms each, in which a lamp switches."""
    rows = np.tile(np.arange(200.0), 3)
    times_ms = rows * 0.1 + np.repeat([0.0, 33.0, 66.0], 200)
    part = np.clip((times_ms - at_ms) / width_ms + 0.5, 0, 1)
    lit = part**bend if rising else (1 - part) ** bend
    noise = np.random.default_rng(round(at_ms)).normal(0, 0.01, 600)
    return BlinkEdge(rising, rows, times_ms, lit + noise, np.full(600, 0.01))


@pytest.mark.parametrize("rising", [True, False])
def test_the_rows_before_and_after_tell_roughly_when_it_switched(rising: bool) -> None:
    assert ramp_edge(40.0, 4.0, rising=rising).rough_ms == pytest.approx(40.0, abs=0.3)
    thinned = ramp_edge(40.0, 4.0, rising=rising).every(5)
    assert np.unique(thinned.row).tolist() == list(range(0, 200, 5))
    assert (len(thinned.lit), len(thinned.sd), thinned.rising) == (120, 120, rising)
    assert thinned.rough_ms == pytest.approx(40.0, abs=0.8)


@pytest.mark.parametrize("rising", [True, False])
def test_edges_share_a_ramp_and_each_has_its_time(rising: bool) -> None:
    ats_ms = [38.2, 39.7, 41.3, 43.1, 44.4, 45.8, 46.9]
    edges = [ramp_edge(at, 6.0, 0.8, rising=rising) for at in ats_ms]
    width_ms, bend = fit_ramp(edges, 200)
    assert width_ms == pytest.approx(6.0, rel=0.08)
    assert bend == pytest.approx(0.8, abs=0.12)
    for at, edge in zip(ats_ms, edges, strict=True):
        time = find_edge_time(edge, (width_ms, bend))
        assert time is not None
        assert time[0] == pytest.approx(at, abs=0.05)
        assert time[1] == pytest.approx((at - 33) / 0.1, abs=3)
        assert 0.015 * width_ms <= time[2] < 0.2


def test_the_best_place_lies_between_those_that_are_tried() -> None:
    edge = ramp_edge(40.1, 6.0)
    place, cost = edge.place(39.0, 6.0, (6.0, 1.0))
    assert place == pytest.approx(40.1, abs=0.05)
    assert cost < 75
    # At the border of what is tried, nothing lies between.
    assert edge.place(36.0, 2.0, (6.0, 1.0))[0] == 38.0


def test_an_edge_of_another_shape_or_of_few_rows_has_no_time() -> None:
    ramp = (6.0, 1.0)
    whole = ramp_edge(40.0, 6.0)
    assert find_edge_time(whole, ramp) is not None
    half = whole.row < 68
    early = BlinkEdge(True, whole.row[half], whole.times_ms[half], whole.lit[half], whole.sd[half])
    assert find_edge_time(early, ramp) is None
    few = whole.every(12)
    assert find_edge_time(few, ramp) is None
    assert find_edge_time(whole.every(4), ramp) is not None
    stepped = BlinkEdge(True, whole.row, whole.times_ms, np.where(whole.times_ms > 40, 0.9, 0.2), whole.sd)
    assert find_edge_time(stepped, ramp) is None


def seen(at_ms: Sequence[float] | Array, *, exact: int = 9, reason: str = "") -> SeenLamp:
    """A camera that sees the lamp switch on and off by turns, and times the first edges exactly."""
    times = np.array(at_ms, float)
    edges = {k: (float(ms), 100.0, 0.05) for k, ms in enumerate(times[:exact])}
    return SeenLamp(0.05, True, 480, times, np.arange(len(times)) % 2 == 0, edges, reason)


EDGES_MS = np.array([100.0, 350, 480, 800, 930, 1400, 1530, 2000])


def test_the_same_edges_are_those_of_the_offset_that_most_agree_on() -> None:
    late = seen(EDGES_MS[1:] - 40)
    late = SeenLamp(**(vars(late) | {"rising": np.arange(1, 8) % 2 == 0}))
    assert lamp._same_edges(seen(EDGES_MS), late) == {k: k + 1 for k in range(7)}
    # Of an evenly blinking one, the smallest offset.
    even = np.arange(8) * 200.0
    assert lamp._same_edges(seen(even), seen(even + 30)) == {k: k for k in range(8)}
    # Farther than any offset, and of the other direction, nothing is the same.
    assert lamp._same_edges(seen([100.0]), seen([401.0])) == {}
    opposite = SeenLamp(**(vars(seen([100.0])) | {"rising": np.array([False])}))
    assert lamp._same_edges(seen([100.0]), opposite) == {}


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Offsets of cameras that see the lamp so."""

    def measured(reference: str | None = None, **cameras: SeenLamp) -> Any:
        dataset = cast("Dataset", SimpleNamespace(cameras=tuple(cameras)))
        monkeypatch.setattr(lamp, "see_lamp", lambda _, name: cameras[name])
        return measure_light_offsets(dataset, reference)

    return measured


def test_offsets_are_of_edges_that_cameras_share(rig: Callable[..., Any]) -> None:
    some = seen(EDGES_MS, exact=7)
    found = rig(a=some, b=seen(EDGES_MS - 12.0), c=seen(EDGES_MS - 5.0, exact=2), d=seen([], reason=NO_LAMP))
    assert (found["b"].source, found["b"].offset_ms, found["b"].sd_ms, found["b"].edges) == (
        "reference",
        0,
        0,
        8,
    )
    assert found["a"].offset_ms == pytest.approx(-12.0, abs=0.1)
    assert 0.02 < found["a"].sd_ms < 0.3
    assert found["a"].row_time_ns == pytest.approx(50_000, rel=0.05)
    assert (found["a"].source, found["a"].edges) == ("light", 7)
    assert found["c"].reason == "it shares fewer than 3 of the lamp's edges with b"
    assert found["d"].reason == NO_LAMP
    assert rig("a", a=some, b=seen(EDGES_MS - 12.0))["b"].offset_ms == pytest.approx(12.0, abs=0.1)


def test_a_reference_that_does_not_time_the_lamp_leaves_all_unknown(rig: Callable[..., Any]) -> None:
    two = seen(EDGES_MS, exact=2, reason="too slow")
    found = rig("b", a=seen(EDGES_MS), b=two, c=seen([], reason=NO_LAMP))
    assert [found[name].offset_ms for name in "abc"] == [None] * 3
    assert [found[name].reason for name in "abc"] == [
        "the lamp does not time b: too slow",
        "too slow",
        NO_LAMP,
    ]
    # Nor is a camera's offset known that shares no edges with any other.
    alone = rig("a", a=seen(EDGES_MS), b=seen([], reason=NO_LAMP))
    assert (alone["a"].offset_ms, alone["b"].offset_ms) == (None, None)
    assert alone["a"].reason == "it shares fewer than 3 of the lamp's edges with a"


def test_it_is_said_why_a_camera_times_no_edge(monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = film([40] * 20)
    assert (see_lamp(dataset, "a").reason, len(see_lamp(dataset, "a").exact)) == (NO_LAMP, 0)
    edges = [ramp_edge(at, 6.0) for at in (38.2, 41.3, 44.4, 46.9)]
    monkeypatch.setattr(lamp, "find_blink_edges", lambda *_: edges)
    found = see_lamp(dataset, "a")
    assert (found.reason, sorted(found.exact), found.height, found.recorded) == ("", [0, 1, 2, 3], 8, False)
    assert found.row_ms == pytest.approx(0.7 * 33 / 8)
    assert found.rising.tolist() == [True] * 4
    assert found.rough_ms == pytest.approx([38.2, 41.3, 44.4, 46.9], abs=0.5)
    monkeypatch.setattr(lamp, "find_blink_edges", lambda *_: edges[:2])
    assert see_lamp(dataset, "a").reason == "only 2 of the lamp's edges fall onto its rows; 3 are needed"
    few = [edge.every(100) for edge in edges]
    few = [BlinkEdge(True, e.row[:5], e.times_ms[:5], e.lit[:5], e.sd[:5]) for e in few]
    monkeypatch.setattr(lamp, "find_blink_edges", lambda *_: few)
    assert see_lamp(dataset, "a").reason == "too few rows of its pictures show the lamp's light"
    monkeypatch.setattr(lamp, "find_blink_edges", lambda *_: edges)
    monkeypatch.setattr(lamp, "fit_ramp", lambda *_: (49.0, 1.0))
    assert see_lamp(dataset, "a").reason == "the lamp takes about 49 ms to light up: it has no edge"
    monkeypatch.setattr(lamp, "fit_ramp", lambda *_: (47.0, 1.0))
    assert "no edge" not in see_lamp(dataset, "a").reason
    short = film([40] * 20)
    record = SimpleNamespace(leader_ns=0, exposure_ns=8_000_000, exposure_start_ns=None)
    vars(short)["record"] = lambda camera, k: record
    monkeypatch.setattr(lamp, "fit_ramp", lambda *_: (24.0, 1.0))
    assert "24 ms to light up" in see_lamp(short, "a").reason


def test_rows_that_are_not_recorded_are_taken_as_even_about_the_images_time() -> None:
    rows_ms, row_ms, recorded = lamp._row_times(film([40] * 3, rows=10), "a")
    assert (row_ms, recorded) == (pytest.approx(2.31), False)
    times: Array = rows_ms[2]
    assert times == pytest.approx(66 - 2.31 * 5 + 2.31 * np.arange(10))
