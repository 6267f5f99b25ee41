"""Motion that repeats fits offsets a whole period apart, and both commands say so."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import cv2
import numpy as np
import pytest

from reconstruction.common.geometry import Array
from reconstruction.common.templates import render_lines
from reconstruction.method.timing import judge_timing
from reconstruction.report.findings import sentences
from reconstruction.scene.dataset import Dataset
from reconstruction.time_offsets.crossings import InstantOffset, OffsetFit
from reconstruction.time_offsets.pair_offset import PairOffsets
from reconstruction.time_offsets.repetition import repetitions_ms
from reconstruction.time_offsets.rig_offsets import adjust_offsets, with_changes
from reconstruction.time_offsets.session_offsets import TimeResult
from tests.unit.reconstruction.conftest import texture

PERIOD_MS = 20.0
Drawn = Callable[[Array, int], None]


def disc(turns: float, left: int = 20) -> Drawn:
    """Draw a disc that turns by so much from frame to frame."""

    def draw(image: Array, instant: int) -> None:
        turn = cv2.getRotationMatrix2D((30, 30), 360 * turns * instant, 1.0)
        turned = cv2.warpAffine(texture(5)[:61, :61], turn, (61, 61), borderMode=cv2.BORDER_REFLECT)
        inside = np.hypot(*np.mgrid[-30:31, -30:31]) < 29
        image[30:91, left : left + 61][inside] = turned[inside]

    return draw


def walker(image: Array, instant: int) -> None:
    """Draw a board that walks by."""
    left = 90 + 2 * instant
    image[20:100, left : left + 40] = texture(7)[:80, :40]


class Film:
    """A camera at rest that films what is drawn, with noise."""

    def __init__(self, *drawn: Drawn, count: int = 36) -> None:
        self.drawn, self.count = drawn, count

    def instants(self, *cameras: str) -> tuple[int, ...]:
        """All of them."""
        return tuple(range(self.count))

    def record(self, camera: str, instant: int) -> SimpleNamespace:
        """When an image was taken."""
        return SimpleNamespace(leader_ns=round(instant * PERIOD_MS * 1e6))

    def size(self, camera: str) -> tuple[int, int]:
        """Width and height."""
        return 200, 120

    def grey(self, camera: str, instant: int) -> Array:
        """The image of an instant."""
        image = texture(3)[:120, :200].copy()
        for draw in self.drawn:
            draw(image, instant)
        noise = np.random.default_rng(instant).normal(0, 1.2, image.shape)
        return np.asarray(np.clip(image + noise, 0, 255), np.uint8)


@pytest.mark.parametrize(
    ("drawn", "frames", "of_parts"),
    [
        ((disc(1 / 12),), 12, []),
        ((disc(1 / 12.5),), 12.5, []),
        ((disc(1 / 12), disc(1 / 12, left=110)), 12, []),
        ((disc(1 / 12), disc(1 / 15, left=110)), 0, [12, 15]),
        ((disc(1 / 12), walker), 0, [12]),
        ((walker,), 0, []),
        ((disc(1 / 60),), 0, []),
        ((), 0, []),
    ],
)
def test_a_period_is_that_of_all_that_moves_or_of_a_part(
    drawn: tuple[Drawn, ...], frames: float, of_parts: list[float]
) -> None:
    whole, *parts = repetitions_ms(cast("Dataset", Film(*drawn)), "a")
    assert whole == pytest.approx(frames * PERIOD_MS, abs=PERIOD_MS / 4)
    assert sorted(parts) == pytest.approx([part * PERIOD_MS for part in of_parts], abs=PERIOD_MS / 4)


def test_a_take_of_few_images_shows_no_period() -> None:
    for count in (6, 1):
        assert repetitions_ms(cast("Dataset", Film(disc(1 / 2), count=count)), "a") == [0]


@pytest.mark.parametrize(("late_ms", "certified"), [(0.1, True), (8.0, False)])
def test_both_commands_say_which_other_offsets_fit(late_ms: float, certified: bool) -> None:
    span = "or a multiple of 400 ms more or less"
    instants = tuple(InstantOffset(k, late_ms, 0.5, 20) for k in range(6))
    for period_ms in (0.0, 400.0):
        fit = OffsetFit(late_ms, 0.3, instants=instants, repeats_ms=period_ms)
        timing = judge_timing(("L", "R"), fit, 0.0, PERIOD_MS)
        assert timing.synchronized == certified
        assert (span in sentences("timing.txt", timing=timing)) == bool(period_ms)
        assert not certified or (span in sentences("judgement.txt", timing=timing)) == bool(period_ms)
        measured = {("L", "R"): fit}
        cameras = with_changes(adjust_offsets("LR", "L", measured), measured, PERIOD_MS)
        result = TimeResult(session="s", reference="L", cameras=cameras, calibration="", seconds=1)
        (line,) = render_lines("times.txt", "reconstruction.commands", result=result)[1:]
        assert line.startswith("R: +")
        assert (span in line) == bool(period_ms)


def test_a_camera_whose_offset_another_pair_determines_has_one() -> None:
    measured = {("a", "b"): OffsetFit(0.0, 0.5, repeats_ms=400.0), ("b", "c"): OffsetFit(0.0, 0.5)}
    found = with_changes(adjust_offsets("abc", "a", measured), measured, PERIOD_MS)
    assert [found[name].images.repeats_ms for name in "abc"] == [0.0, 0.0, 0.0]


def turning_ms(turn_deg: float, *, walking: int = 0, instants: int = 8) -> float:
    """Return the period that is said of points on a disc, seen from aside, beside others that walk."""
    rng = np.random.default_rng(3)
    descriptors = rng.normal(0, 1, (60, 128))
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    start, aside = rng.uniform(-50, 50, (60, 2)), np.array([[0.6, 0.1], [0.0, 1.0]])

    def points(camera: str, instant: int, all_moves: bool) -> tuple[Array, Array]:
        angle = np.radians(turn_deg * instant)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        at = 100 + start @ (aside @ turn).T
        at[:walking] = start[:walking] * (1 + 0.02 * instant) + 5.0 * instant
        return descriptors, np.stack([at, at, at])

    dataset = SimpleNamespace(has_image=lambda camera, k: k < instants, period_ns=round(PERIOD_MS * 1e6))
    pair = cast("PairOffsets", SimpleNamespace(dataset=dataset, _points=points))
    fit = OffsetFit(0.1, 0.3, instants=tuple(InstantOffset(k, 0.1, 0.5, 20) for k in range(instants)))
    return PairOffsets._turning_ms(pair, "a", fit)


@pytest.mark.parametrize("turn_deg", [30.0, -20.0])
def test_a_take_shorter_than_a_turn_and_a_half_shows_the_period(turn_deg: float) -> None:
    """A disc that turned once between two cameras was "the same instant", without a span."""
    assert turning_ms(turn_deg) == pytest.approx(360 / abs(turn_deg) * PERIOD_MS, rel=0.01)


def test_what_does_not_turn_or_walks_beside_has_no_period() -> None:
    assert turning_ms(0.0) == 0
    assert turning_ms(30.0, walking=20) == 0
    assert turning_ms(30.0, instants=1) == 0
