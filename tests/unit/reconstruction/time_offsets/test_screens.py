"""A screen is known by pictures shown twice, or by its corners; bodies and stalling cameras are none."""

from typing import cast

import numpy as np
import pytest

from reconstruction.common.geometry import Array
from reconstruction.scene.dataset import Dataset
from reconstruction.time_offsets.screens import find_screen
from tests.unit.reconstruction.conftest import texture
from tests.unit.reconstruction.time_offsets.test_repetition import Drawn, Film, disc, walker

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
        Repeating(walker, television(50.0)),
    ],
)
def test_bodies_and_a_camera_that_repeats_images_are_no_screen(film: Film) -> None:
    assert not find_screen(cast("Dataset", film), "a").any()
