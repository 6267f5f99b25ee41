"""Random recordings of a screen's panel: two cameras' videos, H.264, that nothing synchronized."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from benchmarks.panel.photographs import SCREENS, draw_corners
from benchmarks.simulated.panel_photographs import HandheldPhotograph
from capture_app.companions.panel.cycle_code import Cycle
from capture_app.companions.panel.panel_photograph import Image
from capture_app.companions.panel.pattern import PANELS, Panel

WIDTH, HEIGHT = 480, 360
RATES_HZ = (24.0, 25.0, 30_000 / 1001, 30.0, 50.0, 60_000 / 1001, 60.0, 120.0, 240.0)
APART_S = 600.0
"""Time between a recording's two visits of the panel."""
VISIT_S, SHORT_VISIT_S = 1.0, 0.5
"""Duration of a visit, and that of cameras above 60 frames a second."""
CRYSTAL_PPM = 20.0
TICKS_HZ = 90_000
MARGIN_S = 1.0
"""Time recorded before the first visit and after the last."""


@dataclass(frozen=True, slots=True)
class Screen:
    """What both cameras of a take see: fields of `HandheldPhotograph`."""

    panel: Panel
    response_ns: float
    scan_share: float
    rate_error: float


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera of a take: its own time is (true - start_s) (1 + ppm 1e-6); times in s of the true clock."""

    photograph: HandheldPhotograph
    rate_hz: float
    start_s: float
    ppm: float
    visits_s: tuple[float, ...]
    """When the panel comes into its view."""
    crf: int
    """H.264's constant rate factor; larger is worse."""
    kind: str
    """What is hard about it: dim, oblique, blurred, or nothing."""
    seed: int

    def own_s(self, true_s: float) -> float:
        """Return the camera's own time at a true time."""
        return (true_s - self.start_s) * (1 + self.ppm * 1e-6)

    def true_s(self, own_s: float) -> float:
        """Return the true time at a time of the camera."""
        return own_s / (1 + self.ppm * 1e-6) + self.start_s

    def record(self, path: Path) -> None:
        """Write the video; a frame's time is the middle of its middle row's exposure."""
        with av.open(str(path), "w") as container:
            stream = container.add_stream("libx264", rate=round(self.rate_hz))
            stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
            stream.options = {"crf": str(self.crf), "preset": "veryfast"}
            stream.codec_context.gop_size = round(self.rate_hz)
            stream.time_base = stream.codec_context.time_base = Fraction(1, TICKS_HZ)
            for own_s, picture in self._frames():
                frame = av.VideoFrame.from_ndarray(picture, format="bgr24")
                frame.pts = round(own_s * TICKS_HZ)
                container.mux(stream.encode(frame))
            container.mux(stream.encode())

    def _frames(self) -> Iterator[tuple[float, Image]]:
        """Yield own times and images: all frames of the visits, and one a second between them."""
        rng = np.random.default_rng(self.seed)
        wall = self.photograph.take(0.0, rng)
        wall[:] = np.clip(rng.normal(90, 6, wall.shape), 0, 255)
        visit_s = VISIT_S if self.rate_hz <= 60 else SHORT_VISIT_S
        count = round((self.own_s(self.visits_s[-1]) + visit_s + MARGIN_S) * self.rate_hz)
        for number in range(count):
            own_s = number / self.rate_hz
            true_s = self.true_s(own_s)
            if any(begin_s <= true_s < begin_s + visit_s for begin_s in self.visits_s):
                yield own_s, self._photograph(true_s * 1e9, rng)
            elif number % round(self.rate_hz) == 0:
                yield own_s, wall

    def _photograph(self, true_ns: float, rng: np.random.Generator) -> Image:
        photograph = self.photograph
        cycle = int(true_ns * (1 + photograph.rate_error) / photograph.panel.cycle_ns)
        start_ns = true_ns - photograph.exposure_ns / 2 - (HEIGHT - 1) / 2 * photograph.row_time_ns
        return replace(photograph, cycle=Cycle(cycle, 11)).take(start_ns, rng)


@dataclass(frozen=True, slots=True)
class Take:
    """Two cameras that saw one screen; the first is the reference."""

    cameras: tuple[Camera, Camera]

    @property
    def panel(self) -> Panel:
        """The screen's panel."""
        return self.cameras[0].photograph.panel


def draw_take(seed: int) -> Take:
    """Return the take of that seed: rates, shutters, light, poses and clocks by chance.

    In three of four takes the panel is shown twice, ten minutes apart; in half of all takes it is carried
    from camera to camera.
    """
    rng = np.random.default_rng([seed, 7])
    panel = PANELS[str(rng.choice(SCREENS))]
    response_ns, scan_share = float(rng.uniform(0, 4e6)), float(rng.uniform(0.85, 0.98))
    rate_error = float(rng.choice([0.0, -1e-3])) + float(rng.normal(0, 50e-6))
    visits_s: tuple[float, ...] = (float(rng.uniform(100, 2000)),)
    if rng.random() < 0.75:
        visits_s += (visits_s[0] + APART_S,)
    carried_s = float(rng.uniform(2, 12)) if rng.random() < 0.5 else 0.0
    screen = Screen(panel, response_ns, scan_share, rate_error)
    one, other = (
        _draw_camera(screen, tuple(at + later for at in visits_s), rng) for later in (0.0, carried_s)
    )
    return Take((one, other))


def _draw_camera(screen: Screen, visits_s: tuple[float, ...], rng: np.random.Generator) -> Camera:
    rate_hz = float(rng.choice(RATES_HZ))
    kind = str(rng.choice(["plain", "plain", "dim", "oblique", "blurred"]))
    exposure_ns = 1e9 / rate_hz * float(np.exp(rng.uniform(np.log(0.03), np.log(0.95))))
    way, length = rng.uniform(0, 2 * np.pi), rng.uniform(2, 4) if kind == "blurred" else rng.uniform(0, 1)
    photograph = HandheldPhotograph(
        screen.panel,
        WIDTH,
        HEIGHT,
        draw_corners(screen.panel, rng, WIDTH, HEIGHT, oblique=kind == "oblique"),
        exposure_ns,
        1e9 / rate_hz / HEIGHT * float(rng.uniform(0.2, 0.95)) if rng.random() < 0.85 else 0.0,
        distortion=float(rng.uniform(-0.04, 0.04)),
        defocus=float(rng.uniform(1.0, 1.6) if kind == "blurred" else rng.uniform(0, 0.8)),
        motion=(float(length * np.cos(way)), float(length * np.sin(way))),
        lamp_light=float(rng.uniform(0.08, 0.2) if kind == "dim" else rng.uniform(0.4, 1.2)),
        ambient=float(rng.uniform(0.3, 0.6) if kind == "dim" else rng.uniform(0.4, 1.2)),
        vignette=float(rng.uniform(0, 0.3)),
        gamma=float(rng.uniform(2.0, 2.4)),
        contrast=float(rng.uniform(0, 0.25)),
        full_well=float(rng.uniform(3000, 10000)),
        jpeg_quality=None,
        response_ns=screen.response_ns,
        scan_share=screen.scan_share,
        rate_error=screen.rate_error,
    )
    return Camera(
        photograph,
        rate_hz,
        visits_s[0] - MARGIN_S - float(rng.uniform(0, 5)),
        float(rng.normal(0, CRYSTAL_PPM)),
        visits_s,
        int(rng.integers(18, 29)),
        kind,
        int(rng.integers(1 << 31)),
    )
