"""A screen is known by pictures shown twice, or by its corners; bodies and stalling cameras are none."""

from typing import cast

import numpy as np
import pytest

from reconstruction.common.geometry import Array
from reconstruction.common.templates import render_lines
from reconstruction.method.timing import judge_timing
from reconstruction.report.findings import sentences
from reconstruction.scene.dataset import Dataset
from reconstruction.time_offsets.crossings import InstantOffset, OffsetFit
from reconstruction.time_offsets.rig_offsets import adjust_offsets, with_changes
from reconstruction.time_offsets.screens import find_screen
from reconstruction.time_offsets.session_offsets import TimeResult
from tests.unit.reconstruction.conftest import texture
from tests.unit.reconstruction.time_offsets.test_repetition import PERIOD_MS, Drawn, Film, disc, walker

LEFT, TOP, WIDE, HIGH = 20, 15, 56, 48


def television(rate_hz: float) -> Drawn:
    """Draw a screen that shows so many pictures of a panning camera in a second, at 50 images a second."""

    def draw(image: Array, instant: int) -> None:
        shown = int((instant + 0.4) * rate_hz / 50)
        across, down = 4 * shown, round(60 + 40 * np.sin(0.3 * shown))
        image[TOP : TOP + HIGH, LEFT : LEFT + WIDE] = texture(9)[down : down + HIGH, across : across + WIDE]

    return draw


class Repeating(Film):
    """A camera that delivers every fourth image twice."""

    def grey(self, camera: str, instant: int) -> Array:
        """The image of an instant."""
        return super().grey(camera, instant - (instant % 4 == 3))


def passer(image: Array, instant: int) -> None:
    """Draw a plain board that passes before the screen's lower edge."""
    left = LEFT - 10 + instant
    image[TOP + 20 : TOP + 80, left : left + 14] = 100


def slow_board(image: Array, instant: int) -> None:
    """Draw a board that moves by a pixel from image to image."""
    image[30 : 30 + HIGH, 20 + instant : 20 + instant + WIDE] = texture(9)[60 : 60 + HIGH, 60 : 60 + WIDE]


def conveyor(image: Array, instant: int) -> None:
    """Draw a train whose ends are not in the picture."""
    image[40:90] = texture(9)[40:90, 4 * instant : 4 * instant + 200]


@pytest.mark.parametrize("rate_hz", [40.0, 25.0, 60.0 / 1.6, 50.0, 100.0])
@pytest.mark.parametrize("beside", [walker, passer])
def test_a_screen_is_found_where_it_is(rate_hz: float, beside: Drawn) -> None:
    screen = find_screen(cast("Dataset", Film(television(rate_hz), beside)), "a")
    inside = np.zeros_like(screen)
    inside[TOP : TOP + HIGH, LEFT : LEFT + WIDE] = True
    assert screen[inside].mean() > 0.9
    assert screen[:, LEFT + WIDE + 25 :].mean() == 0


@pytest.mark.parametrize(
    "film",
    [
        Film(walker),
        Film(),
        Film(television(40.0), walker, count=3),
        Film(slow_board),
        Film(slow_board, count=14),
        Film(disc(1 / 12)),
        Film(conveyor),
        Repeating(walker, disc(1 / 12)),
    ],
)
def test_bodies_and_a_camera_that_repeats_images_are_no_screen(film: Film) -> None:
    assert not find_screen(cast("Dataset", film), "a").any()


@pytest.mark.parametrize(("screens", "words"), [(("L",), "L"), (("L", "R"), "L and R"), ((), "")])
def test_both_commands_say_which_screens_they_leave_out(screens: tuple[str, ...], words: str) -> None:
    instants = tuple(InstantOffset(k, 8.0, 0.5, 20) for k in range(6))
    fit = OffsetFit(8.0, 0.3, instants=instants, screens=screens)
    timing = judge_timing(("L", "R"), fit, 0.0, PERIOD_MS)
    measured = {("L", "R"): fit}
    cameras = with_changes(adjust_offsets("LR", "L", measured), measured, PERIOD_MS)
    result = TimeResult(session="s", reference="L", cameras=cameras, calibration="", seconds=1)
    lines = render_lines("times.txt", "reconstruction.commands", result=result)
    for text in sentences("timing.txt", timing=timing), "\n".join(lines):
        assert ("the screen in" in text) == bool(screens)
        assert not screens or f"the screen in the pictures of {words} is left out" in text
