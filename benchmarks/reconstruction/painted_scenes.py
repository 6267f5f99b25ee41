"""Quickly painted sessions of a pair with a known time offset: a street from a car, boards, a ball.

Flat objects are warped into the image by their homographies, the farthest first, and balls are drawn on top.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View

WIDTH, HEIGHT, FOCAL = 400, 300, 350.0
FINER = 2
"""Supersampling factor in each direction."""
NEAREST_M = 1.0
NOISE = 1.2
"""Standard deviation of the sensor's noise, grey levels."""

Place = Callable[[float], tuple[float, float, float]]
"""Position of an object at a time in s, m."""


@dataclass(frozen=True)
class Board:
    """A painted parallelogram: a corner and the two edges from it, m; `path` moves it."""

    corner: tuple[float, float, float]
    right: tuple[float, float, float]
    down: tuple[float, float, float]
    seed: int
    path: Place | None = None


@dataclass(frozen=True)
class Ball:
    """A ball of faint texture."""

    radius_m: float
    path: Place
    grey: float = 200.0


@dataclass(frozen=True)
class Stage:
    """The scene of a rig, and the rig's motion: from its frame at time 0 to its frame at a time in s."""

    boards: Sequence[Board] = ()
    balls: Sequence[Ball] = ()
    rig_path: Callable[[float], tuple[Array, Array]] | None = None
    """The rig's rotation (3, 3) and position (3,) at a time in s."""
    texels_per_m: float = 60.0
    paint: dict[tuple[int, tuple[int, ...]], Array] = field(default_factory=dict)

    def look(self, view: View, time_s: float, noise: np.random.Generator) -> Array:
        """Return the grey image (uint8) of one of the rig's cameras at a time."""
        view = self.placed(view, time_s)
        size = view.width * FINER, view.height * FINER
        finer = np.diag([FINER, FINER, 1.0])
        finer[:2, 2] = (FINER - 1) / 2
        matrix = finer @ view.matrix
        picture = np.full(size[::-1], 110, np.uint8)
        drawn = [(board, self._corner(board, time_s)) for board in self.boards]
        drawn.sort(key=lambda one: -float(np.linalg.norm(_middle(*one) - view.centre)))
        for board, corner in drawn:
            self._draw(picture, matrix, view, board, corner)
        shown = cv2.GaussianBlur(picture, (0, 0), 0.8).astype(np.float32)
        for ball in self.balls:
            _draw_ball(shown, matrix, view, ball, np.array(ball.path(time_s)))
        small = cv2.resize(shown, (view.width, view.height), interpolation=cv2.INTER_AREA)
        small += noise.normal(0, NOISE, small.shape)
        return np.asarray(np.clip(np.rint(small), 0, 255), np.uint8)

    def placed(self, view: View, time_s: float) -> View:
        """Return one of the rig's cameras in its pose at a time."""
        if self.rig_path is None:
            return view
        turned, place = self.rig_path(time_s)
        rotation = view.rotation @ turned.T
        return replace(view, rotation=rotation, translation=view.translation - rotation @ place)

    def _corner(self, board: Board, time_s: float) -> Array:
        moved = (0.0, 0.0, 0.0) if board.path is None else board.path(time_s)
        return np.asarray(np.array(board.corner) + np.array(moved))

    def _draw(self, picture: Array, matrix: Array, view: View, board: Board, corner: Array) -> None:
        right, down = np.array(board.right), np.array(board.down)
        corners = corner + np.array([0 * right, right, right + down, down])
        if ((corners @ view.rotation.T + view.translation)[:, 2] < NEAREST_M).any():
            return
        away = float(np.linalg.norm(_middle(board, corner) - view.centre))
        coarser = 2 ** max(0, round(np.log2(self.texels_per_m * away / matrix[0, 0])))
        wide, high = (float(np.linalg.norm(edge)) for edge in (right, down))
        texels = tuple(max(8, round(side * self.texels_per_m / coarser / 8) * 8) for side in (wide, high))
        if (board.seed, texels) not in self.paint:
            self.paint[board.seed, texels] = _paint(board.seed, texels, coarser)
        along, below = right / texels[0], down / texels[1]
        plane = view.rotation @ np.column_stack([along, below, corner + 0.5 * (along + below)])
        plane[:, 2] += view.translation
        cv2.warpPerspective(
            self.paint[board.seed, texels],
            matrix @ plane,
            picture.shape[::-1],
            dst=picture,
            flags=cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_TRANSPARENT,
        )


def _middle(board: Board, corner: Array) -> Array:
    return np.asarray(corner + 0.5 * (np.array(board.right) + np.array(board.down)))


def _paint(seed: int, shown: tuple[int, ...], coarser: int) -> Array:
    """Return noise at many scales with hard-edged spots, uint8, enlarged to the shown number of texels."""
    rng = np.random.default_rng(seed)
    texels = shown[0] * coarser, shown[1] * coarser
    image = np.zeros(texels[::-1], np.float32)
    for octave in range(1, 7):
        cells = rng.random((2**octave, 2**octave), dtype=np.float32)
        image += 0.8**octave * cv2.resize(cells, texels, interpolation=cv2.INTER_CUBIC)
    image = (image - image.min()) / np.ptp(image)
    for _ in range(min(400, texels[0] * texels[1] // 250)):
        at = int(rng.integers(0, texels[0])), int(rng.integers(0, texels[1]))
        cv2.circle(image, at, int(rng.integers(2, 7)), float(rng.random()), -1)
    small = cv2.resize(image, shown, interpolation=cv2.INTER_AREA)
    return np.asarray(25 + 205 * small, np.uint8)


def _draw_ball(shown: Array, matrix: Array, view: View, ball: Ball, place: Array) -> None:
    """Draw a shaded ball, with a seam that marks its centre poorly."""
    centre = view.rotation @ place + view.translation
    if centre[2] < NEAREST_M:
        return
    at = matrix @ (centre / centre[2])
    radius = matrix[0, 0] * ball.radius_m / centre[2]
    ys, xs = np.mgrid[: shown.shape[0], : shown.shape[1]].astype(np.float32)
    near = np.hypot(xs - at[0], ys - at[1]) / radius
    there = np.clip((1 - near) * radius + 0.5, 0, 1)
    light = ball.grey * (1 - 0.45 * near**2 + 0.12 * (at[1] - ys) / radius)
    light -= 50 * (np.abs(xs - at[0] - 0.25 * radius) < 0.12 * radius)
    shown += there * (light - shown)


def pair(apart_m: float, *, turned_deg: float = 0.0) -> dict[str, View]:
    """Return two cameras side by side that look ahead, turned towards each other by an angle."""
    matrix = np.array([[FOCAL, 0, WIDTH / 2 - 0.5], [0, FOCAL, HEIGHT / 2 - 0.5], [0, 0, 1]])
    views = {}
    for name, side in (("left", -0.5), ("right", 0.5)):
        rotation = cv2.Rodrigues(np.array([0.0, 2 * side * np.radians(turned_deg), 0.0]))[0]
        place = np.array([side * apart_m, 0.0, 0.0])
        views[name] = View(WIDTH, HEIGHT, matrix, np.zeros(5), rotation, -rotation @ place)
    return views


def street(seed: int, *, speed_m_s: float = 10.0) -> Stage:
    """Return houses on both sides, the road, parked cars, and one that overtakes; the rig sways a little."""
    rng = np.random.default_rng(seed)
    boards, number = [], 1000 * (seed + 1)
    for z in np.arange(0.0, 70.0, 5.0):
        for side in (-1, 1):
            number += 1
            x = side * float(rng.uniform(6, 10))
            high = float(rng.uniform(5, 9))
            boards.append(Board((x, 1.5 - high, float(z)), (0, 0, 5.0), (0, high, 0), number))
        number += 1
        boards.append(Board((-6.0, 1.5, float(z)), (12.0, 0, 0), (0, 0, 5.0), number))
    for _ in range(10):
        number += 1
        x, z = float(rng.choice([-1, 1]) * rng.uniform(2.5, 5)), float(rng.uniform(8, 50))
        high = float(rng.uniform(1.2, 3.0))
        boards.append(Board((x - 1, 1.5 - high, z), (2.0, 0, 0), (0, high, 0), number))
    boards.append(Board((-40, -25, 90), (80, 0, 0), (0, 40, 0), number + 1))
    sway, phases = rng.uniform(0.002, 0.006, 3), rng.uniform(0, 6, 3)

    def path(time_s: float) -> tuple[Array, Array]:
        angles = sway * np.sin(2 * np.pi * 1.4 * time_s + phases)
        turned = cv2.Rodrigues(angles * np.array([1.0, 0.6, 0.8]))[0]
        return np.asarray(turned), np.array([0.0, 0.01 * np.sin(9 * time_s), speed_m_s * time_s])

    return Stage(boards, rig_path=path, texels_per_m=30.0)


def in_file(apart_m: float) -> dict[str, View]:
    """Return two cameras of which the right one stands ahead of the left one, on its axis."""
    views = pair(0.0)
    ahead = replace(views["right"], translation=np.array([0.0, 0.0, -apart_m]))
    return views | {"right": ahead}


def crowd(seed: int, movers: int = 12, away_m: float = 40.0) -> Stage:
    """Return a far backdrop, and people running close in front of it."""
    rng = np.random.default_rng(seed)
    number = 500000 * (seed + 1)
    boards = [Board((-away_m, -0.8 * away_m, away_m), (2 * away_m, 0, 0), (0, 1.6 * away_m, 0), number)]
    for k in range(movers):
        x, y, z = (
            rng.uniform(-0.45, 0.35) * away_m,
            rng.uniform(-0.35, 0.25) * away_m,
            rng.uniform(0.94, 0.99),
        )
        rate, phase, reach = float(rng.uniform(1.5, 3)), float(rng.uniform(0, 6)), 0.05 * away_m

        def path(
            t: float, rate: float = rate, phase: float = phase, reach: float = reach
        ) -> tuple[float, float, float]:
            return reach * float(np.cos(0.8 * rate * t)), reach * float(np.sin(rate * t + phase)), 0.0

        corner = float(x), float(y), float(z)
        boards.append(Board(corner, (4.0, 0, 0), (0, 4.0, 0), number + k + 1, path))
    return Stage(boards, texels_per_m=12.0)


def room(seed: int, movers: int = 3, size_m: float = 0.7, speed_m_s: float = 1.5, at_rest: int = 6) -> Stage:
    """Return boards that hang in front of a wall, and some that swing at different depths."""
    rng = np.random.default_rng(seed)
    number = 100000 * (seed + 1)
    boards = [Board((-6, -4, 6), (12, 0, 0), (0, 8, 0), number)]
    for _ in range(at_rest):
        number += 1
        x, y, z = rng.uniform(-2.2, 2.0), rng.uniform(-1.6, 1.2), rng.uniform(3.6, 5.5)
        boards.append(Board((float(x), float(y), float(z)), (0.9, 0, 0), (0, 0.7, 0), number))
    for _ in range(movers):
        number += 1
        z = float(rng.uniform(2.6, 3.5))
        x, y = rng.uniform(-0.9, 0.5), rng.uniform(-0.5, 0.3)
        reach, rate, phase = rng.uniform(0.2, 0.4), rng.uniform(0.7, 1.3), rng.uniform(0, 6)
        rate *= speed_m_s / reach

        def path(
            t: float, reach: float = reach, rate: float = rate, phase: float = phase
        ) -> tuple[float, float, float]:
            return (
                float(0.5 * reach * np.sin(0.7 * rate * t)), float(reach * np.sin(rate * t + phase)), 0.0
            )  # fmt: skip

        corner = float(x), float(y), z
        boards.append(Board(corner, (size_m, 0, 0), (0, size_m, 0), number, path))
    return Stage(boards, texels_per_m=110.0)


def panning(seed: int) -> Stage:
    """Return boards at rest and in motion before a rig that pans and tilts on its stand."""
    still = room(seed)
    rates, phases = np.random.default_rng(seed).uniform([2, 2, 1], [5, 5, 2]), seed * np.arange(1.0, 4.0)

    def path(time_s: float) -> tuple[Array, Array]:
        angles = np.array([0.05, 0.09, 0.01]) * np.sin(rates * time_s + phases)
        return np.asarray(cv2.Rodrigues(angles)[0]), np.zeros(3)

    return replace(still, rig_path=path)


def throw(seed: int, radius_m: float = 0.07) -> Stage:
    """Return a ball thrown in front of a wall with boards."""
    rng = np.random.default_rng(seed)
    still = room(seed, movers=0)
    x, z = float(rng.uniform(-0.9, -0.5)), float(rng.uniform(2.6, 3.4))
    up, across = float(rng.uniform(2.6, 3.6)), float(rng.uniform(0.6, 1.4))
    path = lambda t: (x + across * t, 0.7 - up * t + 4.9 * t * t, z)  # noqa: E731
    return Stage(still.boards, [Ball(radius_m, path)], texels_per_m=still.texels_per_m, paint=still.paint)
