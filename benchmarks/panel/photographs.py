"""Random photographs of panels: poses, exposures, row times, blur, glare, covered markers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.simulated.panel_photographs import HandheldPhotograph
from capture_app.companions.panel.pattern import PANELS, Panel

WIDTH, HEIGHT = 960, 720
EXPOSURES_NS = (100e3, 20e6)
ROW_TIMES_NS = (0.0, 30e3)
COMMON_EXPOSURES_NS = (1e9 / 50, 1e9 / 60, 1e9 / 100, 1e9 / 125, 1e9 / 250, 1e9 / 500, 1e9 / 1000)
"""Common exposure settings; half of the photographs use one of these."""
LED_PANELS = ("led-pair", "led-pair", "led-pair", "led-200us")
SCREENS = (
    "screen-60hz-down",
    "screen-60hz-down",
    "screen-60hz-right",
    "screen-120hz-down",
    "screen-144hz-down",
)


@dataclass(frozen=True, slots=True)
class Case:
    """A photograph, its true time, and its camera's parameters."""

    photograph: HandheldPhotograph
    start_ns: float
    told_exposure: bool
    told_row_time: bool
    seed: int

    def picture(self) -> NDArray[np.uint8]:
        """Return the photograph, BGR uint8."""
        return self.photograph.take(self.start_ns, np.random.default_rng(self.seed))

    def shown_ns(self, row: float) -> float:
        """Return the panel's time in the middle of that row's exposure; a screen's cells are delayed."""
        photograph = self.photograph
        return (
            self.start_ns + photograph.exposure_ns / 2 + row * photograph.row_time_ns - photograph.response_ns
        )


def draw_case(seed: int, *, screen: bool) -> Case:
    """Return the case of that seed, with an LED panel or a screen."""
    rng = np.random.default_rng([seed, int(screen)])
    panel = PANELS[str(rng.choice(SCREENS if screen else LED_PANELS))]
    exposure_ns = float(np.exp(rng.uniform(*np.log(EXPOSURES_NS))))
    if rng.random() < 0.5:
        exposure_ns = float(rng.choice(COMMON_EXPOSURES_NS))
    spots = tuple(
        (
            float(rng.uniform(0.1, 0.9) * WIDTH),
            float(rng.uniform(0.1, 0.9) * HEIGHT),
            float(rng.uniform(15, 120)),
            float(rng.uniform(0.05, 0.5)),
        )
        for _ in range(rng.integers(0, 3))
    )
    told = bool(rng.random() < 0.6)
    way, length = rng.uniform(0, 2 * np.pi), rng.uniform(0, 5)
    photograph = HandheldPhotograph(
        panel,
        WIDTH,
        HEIGHT,
        draw_corners(panel, rng),
        exposure_ns,
        float(rng.uniform(*ROW_TIMES_NS)) if rng.random() < 0.85 else 0.0,
        distortion=float(rng.uniform(-0.06, 0.06)),
        defocus=float(rng.uniform(0, 2.0)),
        motion=(float(length * np.cos(way)), float(length * np.sin(way))),
        lamp_light=float(rng.uniform(0.3, 1.3)),
        ambient=float(rng.uniform(0.4, 1.2)),
        uneven=0.0 if screen else 0.05,
        vignette=float(rng.uniform(0, 0.35)),
        glare=spots,
        gamma=float(rng.uniform(2.0, 2.4)),
        contrast=float(rng.uniform(0, 0.25)),
        full_well=float(rng.uniform(3000, 10000)),
        jpeg_quality=int(rng.integers(85, 96)),
        hidden=(int(rng.integers(0, 4)),) if rng.random() < 0.25 else (),
        scan_share=float(rng.uniform(0.85, 0.98)),
        response_ns=float(rng.uniform(0, 4e6)) if screen else 0.0,
        rate_error=float(rng.normal(0, 20e-6)),
    )
    return Case(
        photograph,
        float(rng.uniform(0, panel.cycle_ns)),
        told or bool(rng.random() < 0.3),
        told,
        seed,
    )


def draw_corners(
    panel: Panel, rng: np.random.Generator, width: int = WIDTH, height: int = HEIGHT, *, oblique: bool = True
) -> tuple[tuple[float, float], ...]:
    """Return the panel's corners as seen by a randomly placed camera; it faces the panel if not `oblique`."""
    turned = 1.0 if oblique else 0.3
    while True:
        yaw, pitch = turned * rng.uniform(-0.6, 0.6), turned * rng.uniform(-0.45, 0.45)
        roll = rng.normal(0, 0.12) + (np.pi / 2) * rng.choice([0, 0, 0, 0, 1, 2, 3])
        turns = [
            np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]),
            np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]]),
            np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]]),
        ]
        half = np.array([panel.width, panel.height]) / 2 / panel.width
        frame = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
        places = np.column_stack([frame, np.zeros(4)]) @ (turns[2] @ turns[1] @ turns[0]).T
        distance = rng.uniform(0.95, 1.9)
        seen = places[:, :2] / (places[:, 2:] + distance) * width + [width / 2, height / 2]
        seen += rng.uniform(-60, 60, 2)
        inside = (seen > 12).all() and (seen < [width - 12, height - 12]).all()
        if inside:
            return tuple((float(x), float(y)) for x, y in seen)
