"""What is said of takes as somebody draws them who has not read the judge.

    make bench NAME=bodies
    make bench NAME=bodies BENCH="--kind television --seeds 1"

People walk through a room before two cameras (simulated). Behind them are a television of 25 to 60 pictures a
second, a mirror, a poster of one of them, or their shadows; or discs turn, water moves, a train or a crowd
passes, lamps flicker, a tripod is bumped, exposures differ, or rows are read in opposite directions.

A certificate is false if any rows are over a tenth of a frame apart, a number if the truth is outside its
error. No frame is lost: every change of the offset that is told is a false story. Prints a line for each
take, and the sums.
"""

import json
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.reconstruction.painted_scenes import NEAREST_M, Board, Stage, pair
from benchmarks.reconstruction.verdict_takes import PERIOD_MS, add_image, finish
from benchmarks.report import new_parser
from capture_app.common.errors import BadInputError
from capture_app.session.writing.session_writer import SessionWriter
from reconstruction.common.geometry import Array, View, look_along
from reconstruction.method.timing import Timing, measure_pair_timing
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene
from reconstruction.time_offsets.pair_offset import PairOffsets

STRIPS, SHOTS = 10, 5
"""Parts of an image with a rolling shutter, and of a long exposure, that are painted one after the other."""
READOUTS_MS = {
    "opposite rows": (25.0, -25.0),
    "unequal rows": (25.0, 8.0),
    "upside down": (25.0, 25.0),
    "banding": (25.0, 25.0),
}
"""Time from the first row to the last of both cameras, by kind of take; others have none."""
EXPOSURES_MS = {"unequal exposures": (2.0, 20.0)}
"""Exposures of both cameras about their images' times."""
BUMP_AT, BUMP_PX = 12, 4.0
"""Instant from which a bumped camera's images are moved, and by how much."""
ALIKE_FRAMES = 0.1


@dataclass(frozen=True)
class Room(Stage):
    """A stage with flat areas that are no things: a television, a mirror, shadows."""

    television: Board | None = None
    show: Callable[[float], tuple[float, float]] = lambda time_s: (0.0, 0.0)
    """Path of the television's content, as a fraction of its size; held for each of its pictures."""
    rate_hz: float = 25.0
    """The television's pictures in a second."""
    mirror: Board | None = None
    """Faces the cameras, at its corner's z; all boards before it are seen in it."""
    shadows: bool = False
    turning: dict[int, float] = field(default_factory=dict)
    """Turns in a second of boards, by their seeds."""
    waves: dict[int, float] = field(default_factory=dict)
    """Height of waves that travel over boards, as a fraction of their size, by their seeds."""
    light: Callable[[Array], Array] = np.ones_like
    """How bright a lamp is at times in s."""

    def look(self, view: View, time_s: float, noise: np.random.Generator) -> Array:
        """Return the grey image (uint8) of a camera at a time."""
        still, moving = (
            [board for board in self.boards if (board.path is None) == rests] for rests in (True, False)
        )
        silent = np.random.default_rng(0)
        plain = replace(self, television=None, mirror=None, shadows=False)
        picture = Stage.look(replace(plain, boards=still), view, time_s, silent).astype(np.float32)
        if self.shadows:
            picture *= self._shadow(view, moving, time_s)
        if self.television is not None:
            picture = self._shown(picture, view, self.television, time_s)
        if self.mirror is not None:
            picture = self._mirrored(picture, view, self.mirror, moving, time_s)
        for board in sorted(moving, key=lambda one: -one.corner[2]):
            picture = self._over(picture, view, board, time_s)
        return np.asarray(np.clip(np.rint(picture + noise.normal(0, 1.2, picture.shape)), 0, 255), np.uint8)

    def _over(
        self, picture: Array, view: View, board: Board, time_s: float, paint: Array | None = None
    ) -> Array:
        """Draw a board over a picture."""
        corner = _corner(board, time_s)
        if corner[2] < NEAREST_M:
            return picture
        paint = texture(board.seed) if paint is None else paint
        shape, alpha = paint, np.full(paint.shape, 255, np.uint8)
        if board.seed in self.turning:
            middle = (paint.shape[1] / 2 - 0.5, paint.shape[0] / 2 - 0.5)
            turn = cv2.getRotationMatrix2D(middle, 360 * self.turning[board.seed] * time_s, 1.0)
            shape = cv2.warpAffine(paint, turn, paint.shape[::-1], borderMode=cv2.BORDER_REFLECT)
            ys, xs = np.mgrid[: paint.shape[0], : paint.shape[1]]
            alpha = np.asarray(255 * (np.hypot(xs - middle[0], ys - middle[1]) < middle[0] - 1), np.uint8)
        if board.seed in self.waves:
            high, (ys, xs) = self.waves[board.seed] * len(paint), np.mgrid[: len(paint), : paint.shape[1]]
            across = xs + high * np.sin(0.11 * ys + 0.05 * xs + 7.0 * time_s)
            down = ys + high * np.sin(0.09 * xs - 0.04 * ys + 5.3 * time_s)
            shape = cv2.remap(
                paint, np.float32(across), np.float32(down), cv2.INTER_LINEAR, None, cv2.BORDER_REFLECT
            )
        matrix = _plane(view, corner, board, paint.shape)
        warped = cv2.warpPerspective(shape, matrix, (2 * view.width, 2 * view.height), flags=cv2.INTER_LINEAR)
        cover = cv2.warpPerspective(alpha, matrix, (2 * view.width, 2 * view.height), flags=cv2.INTER_LINEAR)
        both = (
            cv2.resize(one.astype(np.float32), picture.shape[::-1], interpolation=cv2.INTER_AREA)
            for one in (warped * (cover > 127), 255.0 * (cover > 127))
        )
        seen, part = both
        return np.asarray(picture * (1 - part / 255) + seen)

    def _shown(self, picture: Array, view: View, board: Board, time_s: float) -> Array:
        held_s = np.floor(time_s * self.rate_hz + 0.37) / self.rate_hz
        x, y = self.show(held_s)
        large = texture(board.seed, 1024)
        high = 288
        left, top = (round(300 + 300 * one) for one in (x, y))
        frame = large[top : top + high, left : left + 512]
        edge = replace(
            board,
            corner=tuple(np.array(board.corner) - (0.04, 0.04, 0)),
            right=(board.right[0] + 0.08, 0, 0),
            down=(0, board.down[1] + 0.08, 0),
        )
        picture = self._over(picture, view, edge, time_s, np.full((64, 64), 20, np.uint8))
        return self._over(picture, view, board, time_s, np.ascontiguousarray(frame))

    def _mirrored(
        self, picture: Array, view: View, mirror: Board, moving: Sequence[Board], time_s: float
    ) -> Array:
        plane = mirror.corner[2]
        behind = picture.copy()
        for board in sorted(moving, key=lambda one: one.corner[2]):
            corner = _corner(board, time_s)
            there = tuple(corner * (1, 1, -1) + (0, 0, 2 * plane))
            behind = self._over(behind, view, replace(board, corner=there, path=None), time_s)
        glass = (
            self._over(np.zeros_like(picture), view, mirror, time_s, np.full((64, 64), 255, np.uint8)) / 255
        )
        return np.asarray(picture * (1 - glass) + glass * (15 + 0.85 * behind))

    def _shadow(self, view: View, moving: Sequence[Board], time_s: float) -> Array:
        """Return the light that people leave on the wall, from a lamp beside the cameras."""
        lamp, light = np.array([-1.5, -1.5, 0.0]), np.ones((view.height, view.width), np.float32)
        for board in moving:
            corner = _corner(board, time_s)
            scale = (5.98 - lamp[2]) / (corner[2] - lamp[2])
            there = lamp + (corner - lamp) * scale
            large = replace(
                board,
                corner=tuple(there),
                right=tuple(np.array(board.right) * scale),
                down=tuple(np.array(board.down) * scale),
                path=None,
            )
            dark = (
                self._over(np.zeros_like(light), view, large, time_s, np.full((64, 64), 255, np.uint8)) / 255
            )
            light *= 1 - 0.5 * cv2.GaussianBlur(dark, (0, 0), 2.0)
        return light


def _corner(board: Board, time_s: float) -> Array:
    """Return where a board's corner is at a time, (3,) m."""
    return np.asarray(
        np.array(board.corner) + np.array(board.path(time_s) if board.path else (0.0, 0.0, 0.0))
    )


_TEXTURES: dict[tuple[int, int], Array] = {}


def texture(seed: int, size: int = 256) -> Array:
    """Return noise at many scales with hard-edged spots, uint8 size x size."""
    if (seed, size) not in _TEXTURES:
        rng = np.random.default_rng(abs(seed))
        image = np.zeros((size, size), np.float32)
        for octave in range(2, 8):
            cells = rng.random((2**octave, 2**octave), dtype=np.float32)
            image += 0.75**octave * cv2.resize(cells, (size, size), interpolation=cv2.INTER_CUBIC)
        image = (image - image.min()) / np.ptp(image)
        for _ in range(60 * size // 256):
            cv2.circle(
                image,
                tuple(int(v) for v in rng.integers(0, size, 2)),
                int(rng.integers(4, 18)),
                float(rng.random()),
                -1,
            )
        # Clothes of a negative seed are plain.
        contrast = 200 if seed > 0 else 60
        _TEXTURES[seed, size] = np.asarray(30 + (200 - contrast) / 2 + contrast * image, np.uint8)
    return _TEXTURES[seed, size]


def _plane(view: View, corner: Array, board: Board, shape: tuple[int, ...]) -> Array:
    """Return the homography (3, 3) from a board's texels to pixels of twice the view's size."""
    finer = np.array([[2, 0, 0.5], [0, 2, 0.5], [0, 0, 1]])
    along, below = np.array(board.right) / shape[1], np.array(board.down) / shape[0]
    plane = view.rotation @ np.column_stack([along, below, corner + 0.5 * (along + below)])
    plane[:, 2] += view.translation
    return np.asarray(finer @ view.matrix @ plane)


def person(rng: np.random.Generator, number: int) -> list[Board]:
    """Return torso, head, arm and legs of somebody who walks through the room."""
    z, side = float(rng.uniform(2.6, 3.8)), float(rng.choice([-1, 1]))
    speed, start, phase = (
        side * float(rng.uniform(0.7, 1.3)),
        -side * float(rng.uniform(0.3, 1.0)),
        float(rng.uniform(0, 6)),
    )
    rate = 2 * np.pi * float(rng.uniform(0.85, 1.1))

    def walk(swing: float = 0.0, lag: float = 0.0) -> Callable[[float], tuple[float, float, float]]:
        def path(t: float) -> tuple[float, float, float]:
            step = swing * float(np.sin(rate * t + phase + lag))
            return start + speed * t + step, 0.05 * float(np.sin(2 * rate * t + phase)) - abs(step) * 0.3, 0.0

        return path

    parts = [((-0.12, -0.85), (0.24, 0.3), walk()), ((-0.25, -0.55), (0.5, 0.65), walk())]
    parts += [((-0.22 + 0.24 * k, 0.1), (0.2, 0.8), walk(0.22, np.pi * k)) for k in (0, 1)]
    parts += [((-0.06, -0.45), (0.13, 0.6), walk(0.3, 1.0))]
    return [
        Board((x, y, z - 0.02 * k), (wide, 0, 0), (0, high, 0), number + k, path)
        for k, ((x, y), (wide, high), path) in enumerate(parts)
    ]


def room_of(kind: str, seed: int) -> Room:
    """Return the scene of a take."""
    rng = np.random.default_rng([seed, 17])
    number = 100000 * (seed + 1)
    boards = [Board((-6, -4, 6), (12, 0, 0), (0, 8, 0), number)]
    for k in range(5):
        x, y, z = rng.uniform(-2.2, 2.0), rng.uniform(-1.6, 1.2), rng.uniform(4.6, 5.8)
        boards.append(Board((float(x), float(y), float(z)), (0.8, 0, 0), (0, 0.6, 0), number + 1 + k))
    people = [*person(rng, number + 20), *person(rng, number + 30)]
    rates, phases = rng.uniform(2, 4, 2), rng.uniform(0, 6, 2)
    place = (float(rng.uniform(-1.2, -0.2)), float(rng.uniform(-0.9, -0.2)), 4.4)
    flat = Board(place, (1.6, 0, 0), (0, 0.9, 0), number + 50)
    show = lambda t: (float(np.sin(rates[0] * t + phases[0])), float(np.cos(rates[1] * t + phases[1])))  # noqa: E731
    plain = [replace(board, seed=-board.seed) for board in people]
    large = replace(flat, corner=(place[0] - 0.6, place[1] - 0.4, 4.4), right=(2.6, 0, 0), down=(0, 1.5, 0))
    glass = replace(flat, corner=(-1.5, -1.4, 5.0), right=(3.0, 0, 0), down=(0, 2.4, 0))
    # Who is seen in the mirror alone walks behind the cameras.
    behind = [replace(board, corner=(*board.corner[:2], board.corner[2] - 4.5)) for board in people]
    poster = Board((*place[:2], 4.4), (0.6, 0, 0), (0, 0.78, 0), people[1].seed, lambda t: (0.0, 0.0, 0.0))
    disc = Board((-0.5, -0.5, 3.0), (1.0, 0, 0), (0, 1.0, 0), number + 60, lambda t: (0.0, 0.0, 0.0))
    second = replace(disc, corner=(0.4, -0.4, 3.2), seed=number + 61)
    crowd = [
        replace(board, corner=(board.corner[0] + x, board.corner[1] - 0.1, board.corner[2] + 1.2))
        for k, x in enumerate((-1.2, -0.5, 0.2, 0.9, 1.5))
        for board in person(rng, number + 100 + 10 * k)
    ]
    water = Board((-3.0, 0.5, 4.2), (6.0, 0, 0), (0, 1.6, 0), number + 80, lambda t: (0.0, 0.0, 0.0))
    mains = lambda t: 1 + 0.25 * np.sin(2 * np.pi * 100 * t)  # noqa: E731
    lamp = lambda t: 1 + 0.3 * (np.sin(2 * np.pi * 13.7 * t) > 0)  # noqa: E731
    train = Board((-12.0, -0.9, 4.8), (30.0, 0, 0), (0, 1.3, 0), number + 70, lambda t: (2.0 * t, 0.0, 0.0))
    stage = Room([*boards, *people], texels_per_m=110.0, show=show)
    kinds: dict[str, dict[str, Any]] = {
        "television": {"television": flat},
        "television, one walks": {"boards": [*boards, *people[:5]], "television": flat},
        "large television": {"boards": [*boards, *plain], "television": large},
        "large television of 30 Hz": {"boards": [*boards, *plain], "television": large, "rate_hz": 30.0},
        "large television of 50 Hz": {"boards": [*boards, *plain], "television": large, "rate_hz": 50.0},
        "large television of 60 Hz": {"boards": [*boards, *plain], "television": large, "rate_hz": 60.0},
        "television of 30 Hz": {"television": flat, "rate_hz": 30.0},
        "television alone": {"boards": boards, "television": flat},
        "television of 30 Hz alone": {"boards": boards, "television": flat, "rate_hz": 30.0},
        "mirror": {"mirror": glass},
        "mirror alone": {"boards": [*boards, *behind], "mirror": glass},
        "poster": {"boards": [*boards, poster, *people]},
        "shadow": {"shadows": True},
        "disc": {"boards": [*boards, disc], "turning": {disc.seed: 2.5}},
        "short disc": {"boards": [*boards, disc], "turning": {disc.seed: 2.5}},
        "two periods": {"boards": [*boards, disc, second], "turning": {disc.seed: 2.5, second.seed: 5 / 3}},
        "train": {"boards": [*boards, train, *people[:5]]},
        "crowd": {"boards": [*boards, *crowd]},
        "water": {"boards": [*boards, water], "waves": {water.seed: 0.03}},
        "flicker": {"light": lamp},
        "banding": {"light": mains},
    }
    return replace(stage, **kinds.get(kind, {}))


def views_of(seed: int) -> dict[str, View]:
    """Return two cameras of which the right one stands lower."""
    views = pair(0.45, turned_deg=3)
    rng = np.random.default_rng([seed, 5])
    place = np.array([0.22, float(rng.uniform(0.05, 0.15)), 0.0])
    ahead = np.array([0.0, 0.0, 4.0]) - place
    rotation = look_along(ahead / np.linalg.norm(ahead), np.array([0.0, 1.0, 0.0]))
    return views | {"right": replace(views["right"], rotation=rotation, translation=-rotation @ place)}


KINDS: Mapping[str, tuple[int, tuple[float, ...]]] = {
    "television": (24, (0.0, 16.7, 6.0)),
    "television, one walks": (24, (0.0, 16.7, 6.0)),
    "large television": (24, (0.0, 16.7, 6.0)),
    "large television of 30 Hz": (24, (0.0, 16.7, -6.0)),
    "large television of 50 Hz": (24, (0.0, -6.0)),
    "large television of 60 Hz": (24, (0.0, -6.0)),
    "television of 30 Hz": (24, (0.0, -6.0)),
    "television alone": (24, (0.0, 16.7, 6.0)),
    "television of 30 Hz alone": (24, (0.0, -6.0)),
    "mirror": (24, (0.0, 10.0)),
    "mirror alone": (24, (0.0, 10.0)),
    "poster": (24, (0.0, 10.0)),
    "shadow": (24, (0.0, 10.0)),
    "people": (24, (0.0, 10.0)),
    "train": (24, (0.0, 10.0)),
    "disc": (36, (0.0, 400.0)),
    "short disc": (14, (0.0, 400.0)),
    "two periods": (36, (0.0, 400.0)),
    "crowd": (24, (0.0, 10.0)),
    "water": (24, (0.0, 10.0)),
    "flicker": (24, (0.0, 10.0)),
    "banding": (24, (0.0, 10.0)),
    "bumped": (24, (0.0, 10.0)),
    "unequal exposures": (24, (0.0, 10.0)),
    "opposite rows": (24, (0.0,)),
    "unequal rows": (24, (0.0,)),
    "upside down": (24, (0.0,)),
}
"""Instants, and the right camera's delays, ms."""


UNEQUAL_ROWS = "opposite rows", "unequal rows", "upside down"


def session_of(kind: str, seed: int, late_ms: float, cache: Path) -> Path:
    """Return a take's session, painted on the first call."""
    name = f"{kind}-{seed}-{late_ms:g}".replace(" ", "_").replace(",", "").replace(".", "p")
    if (cache / name / "session.json").is_file():
        return cache / name
    stage, views, frames = room_of(kind, seed), views_of(seed), KINDS[kind][0]
    writer, rng = SessionWriter.create(cache, name), np.random.default_rng([seed, 7])
    if kind == "upside down":
        turned = np.diag([-1.0, -1.0, 1.0])
        right = views["right"]
        views["right"] = replace(
            right, rotation=turned @ right.rotation, translation=turned @ right.translation
        )
    for k in range(frames):
        for number, (camera, view) in enumerate(views.items()):
            at_ms = k * PERIOD_MS + late_ms * number
            if kind == "bumped" and number and k >= BUMP_AT:
                view = replace(
                    view, matrix=view.matrix + BUMP_PX * np.array([[0, 0, 1], [0, 0, 0.3], [0, 0, 0]])
                )
            image = filmed(
                stage,
                view,
                at_ms,
                READOUTS_MS.get(kind, (0, 0))[number],
                EXPOSURES_MS.get(kind, (0, 0))[number],
                rng,
            )
            add_image(writer, camera, k, image)
    finish(writer, views, frames)
    return cache / name


def filmed(
    stage: Room, view: View, at_ms: float, readout_ms: float, exposure_ms: float, rng: np.random.Generator
) -> Array:
    """Return an image with these times from its first row to its last, and from shutter to shutter.

    Rows are painted in strips; each has a light of its own.
    """
    parts, strips, shots = [], STRIPS if readout_ms else 1, SHOTS if exposure_ms else 1
    for strip in range(strips):
        row_ms = ((strip + 0.5) / strips - 0.5) * readout_ms
        times_ms = (at_ms + row_ms + ((shot + 0.5) / shots - 0.5) * exposure_ms for shot in range(shots))
        seen = np.mean([stage.look(view, 0.05 + ms / 1e3, rng) for ms in times_ms], axis=0)
        parts.append(seen[strip * view.height // strips : (strip + 1) * view.height // strips])
    rows_ms = at_ms + np.linspace(-0.5, 0.5, view.height) * readout_ms
    light = stage.light(0.05 + rows_ms / 1e3)[:, None]
    return np.asarray(np.clip(np.rint(np.concatenate(parts) * light), 0, 255), np.uint8)


def measure(session: Path) -> Timing:
    """Return the judgement of a session's two cameras; unknown if its calibration is refused."""
    scene = Scene(Dataset.open(session))
    first, second = scene.dataset.cameras
    try:
        return measure_pair_timing(PairOffsets(scene), (first, second))
    except BadInputError as error:
        return Timing(reference=first, other=second, reason=str(error))


def main() -> None:
    """Print what is said of each take, or with --json one object."""
    parser = new_parser(__doc__)
    parser.add_argument("--kind", help="only this kind")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--cache", type=Path, help="keeps what was painted")
    chosen = parser.parse_args()
    sums, rows = Counter[str](), []
    with tempfile.TemporaryDirectory() as scratch:
        for kind, (_, delays_ms) in KINDS.items():
            for seed in range(chosen.first, chosen.first + chosen.seeds):
                for late_ms in delays_ms if chosen.kind in (None, kind) else ():
                    timing = measure(session_of(kind, seed, late_ms, chosen.cache or Path(scratch)))
                    known = timing.late_ms is not None and timing.uncertainty_ms is not None
                    off_ms = abs((timing.late_ms or 0.0) - late_ms)
                    span_ms = timing.images.repeats_ms
                    if span_ms:
                        off_ms = abs((off_ms + span_ms / 2) % span_ms - span_ms / 2)
                    words = "certified" if timing.synchronized else "denied" if timing.offset else "not told"
                    faults = {
                        "false certificate": timing.synchronized
                        and (off_ms > ALIKE_FRAMES * PERIOD_MS or kind in UNEQUAL_ROWS),
                        "false denial": timing.offset and not late_ms and kind not in UNEQUAL_ROWS,
                        "false number": known
                        and off_ms > (timing.uncertainty_ms or 0) + 0.1
                        and not timing.reason,
                        "false story": bool(timing.change) or "changes over the take" in timing.reason,
                    }
                    sums.update([words, *(fault for fault, holds in faults.items() if holds)])
                    sums.update(
                        {"numbers": known, "bars that hold": known and off_ms <= (timing.uncertainty_ms or 0)}
                    )
                    said = f"{timing.late_ms:+.2f} ± {timing.uncertainty_ms:.2f}" if known else "-"
                    wrong = " ".join(fault.upper() for fault, holds in faults.items() if holds)
                    rows.append(
                        {
                            "kind": kind,
                            "seed": seed,
                            "late_ms": late_ms,
                            "words": words,
                            "said": said,
                            "wrong": wrong,
                        }
                    )
                    span = f" (span {span_ms:.0f})" if span_ms else ""
                    print(
                        f"{kind} {seed} {late_ms:g}: {words} {said}{span} {timing.reason} {wrong}", flush=True
                    )
    print(json.dumps({"takes": rows, "sums": sums} if chosen.json else sums))


if __name__ == "__main__":
    main()
