"""Sessions of a pair with a known time offset, painted and real, to test timing judgements."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import msgspec
import numpy as np

from benchmarks.reconstruction import painted_scenes
from benchmarks.reconstruction.painted_scenes import HEIGHT, WIDTH, Stage
from capture_app.common.errors import BadInputError
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.companions.importing.recording import import_found
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import CALIBRATION, BurstRecord, CameraRecord
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from reconstruction.common.geometry import Array, View, epipolar_errors_px
from tests.facts import make_facts

PERIOD_MS = 1e3 / 30


@dataclass(frozen=True)
class Take:
    """Content of a session, and the right camera's true delay; each of its images draws `jitter_ms`."""

    kind: str
    seed: int
    late_ms: float = 0.0
    jitter_ms: float = 0.0
    geometry_px: float = 0.0
    """Error of its calibration: the median distance from epipolar lines."""
    fault: str = ""
    """One of `FAULTS`, which alone is wrong in the calibration; empty = a little of each."""
    frames: int = 14
    start: int = 0
    """The first frame of a real recording."""
    drops: tuple[int, ...] = ()
    """The instants from which the right camera is a frame later, as it has lost one before each."""
    doubles: tuple[int, ...] = ()
    """The instants at which the right camera repeats a frame; from there on it is a frame earlier."""
    slower: float = 0.0
    """Fraction by which the right camera's frames last longer than recorded."""
    wander_ms: float = 0.0
    """Amplitude of a slow swing of the right camera's times."""
    glitches: tuple[int, ...] = ()
    """The single instants at which the right camera is a frame late."""
    repeats: tuple[int, ...] = ()
    """The single instants at which the right camera delivers its image before again."""
    late_or_not_ms: float = 0.0
    """Delay of the right camera at half of its instants, drawn; the others have none."""
    guess: bool = False
    """Whether the session has no calibration, so that one is guessed from its images."""

    @property
    def name(self) -> str:
        """Folder name of its session."""
        told = f"{self.kind}-{self.seed}-{self.late_ms:g}-{self.jitter_ms:g}-{self.geometry_px:g}"
        if self.drops or self.doubles or self.slower or self.wander_ms:
            told += f"-drops{self.drops}{self.doubles}-{self.slower:g}-{self.wander_ms:g}"
        told += f"-single{self.glitches}{self.repeats}{self.late_or_not_ms:g}" * self.singly_late
        told += f"-{self.start}-{self.frames}{self.fault}" + "-guess" * self.guess
        return re.sub(r"[ ,()]+", "_", told).replace(".", "p")

    @property
    def truly_synchronized(self) -> bool:
        """Whether its images are of one instant."""
        return not self.late_ms and not self.jitter_ms and not self.unsteady

    @property
    def singly_late(self) -> bool:
        """Whether single images are off."""
        return bool(self.glitches or self.repeats or self.late_or_not_ms)

    @property
    def unsteady(self) -> bool:
        """Whether the right camera's delay changes over the take."""
        return bool(self.drops or self.doubles or self.slower or self.wander_ms or self.singly_late)

    def delays_ms(self) -> Array:
        """Return the right camera's delay at each instant (frames,) ms, without jitter."""
        k = np.arange(self.frames)
        lost = sum((k >= drop for drop in self.drops), np.zeros(self.frames))
        lost = lost - sum((k >= double for double in self.doubles), np.zeros(self.frames))
        swing = self.wander_ms * np.sin(2 * np.pi * (k / 22 + 0.1 * self.seed))
        single = self.period_ms * np.isin(k, self.glitches)
        single += self.late_or_not_ms * np.random.default_rng(self.seed).integers(0, 2, self.frames)
        return np.asarray(self.late_ms + (lost + self.slower * k) * self.period_ms + swing + single)

    @property
    def period_ms(self) -> float:
        """Time from frame to frame."""
        return 1e3 / 60 if self.kind == BALL else PERIOD_MS


BALL = "real ball"
BALL_SIZE, BALL_DEPTHS = (640, 480), (100.0, 600.0)
"""Its images, px, and the depths in them, inches."""
ROLLING = "rolling shutter"
FAULTS = ("focal length", "principal point", "rotation", "moved camera", "lens", ROLLING)
SIZES_PX = (0.1, 0.5, 1.5, 4.0, 8.0, 15.0)
JITTERS_MS = (2.0, 3.5, 6.0, 10.0, 15.0)
STRIPS = 10
"""Parts of a rolling image that are painted one after the other."""
READOUT_MS_PER_PX = 2.0
"""Readout of the right camera alone, unknown to the calibration, by the take's size of the fault."""
STAGES: dict[str, Callable[[int], tuple[Stage, dict[str, View]]]] = {
    "street": lambda seed: (painted_scenes.street(seed), painted_scenes.pair(0.5)),
    "slow street": lambda seed: (painted_scenes.street(seed, speed_m_s=3.0), painted_scenes.pair(0.4)),
    "boards": lambda seed: (painted_scenes.room(seed), painted_scenes.pair(0.3, turned_deg=2)),
    "slow boards": lambda seed: (
        painted_scenes.room(seed, speed_m_s=0.25), painted_scenes.pair(0.3, turned_deg=2)
    ),
    "large mover": lambda seed: (
        painted_scenes.room(seed, movers=1, size_m=2.0), painted_scenes.pair(0.3, turned_deg=2)
    ),
    "small mover": lambda seed: (
        painted_scenes.room(seed, movers=1, size_m=0.25, speed_m_s=2.0), painted_scenes.pair(0.4)
    ),
    "thrown ball": lambda seed: (painted_scenes.throw(seed), painted_scenes.pair(0.5)),
    "panning": lambda seed: (painted_scenes.panning(seed), painted_scenes.pair(0.4)),
}  # fmt: skip
FLAT_STAGES: dict[str, Callable[[int], tuple[Stage, dict[str, View]]]] = {
    "wall": lambda seed: (painted_scenes.room(seed, at_rest=0), painted_scenes.pair(0.3, turned_deg=2)),
    "wall, one board": lambda seed: (
        painted_scenes.room(seed, at_rest=1), painted_scenes.pair(0.3, turned_deg=2)
    ),
    "distant crowd": lambda seed: (painted_scenes.crowd(seed), painted_scenes.pair(0.5)),
    "one ahead": lambda seed: (painted_scenes.room(seed), painted_scenes.in_file(0.5)),
    "one turned": lambda seed: (painted_scenes.room(seed), painted_scenes.pair(0.04, turned_deg=12)),
}  # fmt: skip
"""Scenes that determine a calibration poorly: flat, far away, or seen by cameras almost at one place."""


def takes(seeds: int) -> Iterator[Take]:
    """Yield every kind with this number of seeds."""
    for seed in range(seeds):
        for kind in STAGES:
            yield Take(kind, seed)
            yield Take(kind, seed, geometry_px=(0.3, 0.5, 0.1)[seed % 3])
            yield Take(kind, seed, late_ms=(10.0, -8.0, 14.0)[seed % 3], geometry_px=(0.0, 0.3)[seed % 2])
        yield Take("boards", seed, late_ms=(1.0, -2.0, 4.0)[seed % 3])
        yield Take("boards", seed, late_ms=2 * PERIOD_MS)
        yield Take("boards", seed, jitter_ms=(8.0, 5.0, 12.0)[seed % 3])
        yield Take("street", seed, jitter_ms=8.0)
        yield Take("thrown ball", seed, late_ms=PERIOD_MS)
        yield Take("boards", seed, frames=5)
        yield Take("street", seed, frames=5, geometry_px=0.3)
        yield Take("thrown ball", seed, frames=8)
        for jitter_ms in JITTERS_MS:
            yield Take(("boards", "large mover", "thrown ball")[seed % 3], seed, jitter_ms=jitter_ms)
        for number, fault in enumerate(FAULTS):
            for part, kind in enumerate(("boards", "thrown ball")):
                place = seed + number + 3 * part
                late_ms = (0.0, 0.0, 12.0, -6.0)[place % 4]
                size = SIZES_PX[place % len(SIZES_PX)]
                yield Take(kind, seed, late_ms=late_ms, geometry_px=size, fault=fault)


def flat_takes(seeds: int) -> Iterator[Take]:
    """Yield every kind of `FLAT_STAGES`, on time and late, calibrated and guessed; and guesses of others."""
    for seed in range(seeds):
        late_ms = (10.0, -8.0, 14.0)[seed % 3]
        for kind in FLAT_STAGES:
            for guess in (False, True):
                yield Take(kind, seed, guess=guess)
                yield Take(kind, seed, late_ms=(late_ms, 2 * PERIOD_MS)[guess], guess=guess)
            yield Take(kind, seed, frames=30, guess=True)
        for kind in ("boards", "large mover", "thrown ball", "slow boards", "street"):
            yield Take(kind, seed, guess=True)
            yield Take(kind, seed, late_ms=late_ms, guess=True)
        yield Take("boards", seed, drops=(14,), frames=30, guess=True)


def unsteady_takes(seeds: int) -> Iterator[Take]:
    """Yield takes whose right camera drops or repeats frames, has another rate, or wanders; and controls."""
    for seed in range(seeds):
        for part, kind in enumerate(("boards", "street", "large mover", "small mover", "slow boards")):
            place = seed + part
            long = Take(kind, seed, frames=30, geometry_px=(0.0, 0.3)[place % 2])
            yield replace(long, drops=(9 + 5 * (place % 3),))
            yield replace(long, drops=(8, 20 + place % 4))
            yield replace(long, drops=((3, 27), (4,), (26,))[place % 3])
            yield replace(long, doubles=(10 + 3 * (place % 4),))
            yield replace(long, slower=(0.001, 0.005, 0.01, 0.02, 0.05)[place % 5])
            yield replace(long, wander_ms=(4.0, 8.0, 12.0)[place % 3])
            yield long
        yield Take("boards", seed, late_ms=6.0, drops=(15,), frames=30)
        yield Take("boards", seed, drops=(7,), doubles=(19,), frames=30)
        yield Take("boards", seed, slower=-0.03, frames=30)
        yield Take("boards", seed, slower=30 / 25 - 1, frames=30)


def single_image_takes() -> Iterator[Take]:
    """Yield takes of which single images are off, of every kind in four scenes; and steady ones."""
    for kind in ("boards", "large mover", "slow boards", "street"):
        long = Take(kind, 0, frames=30)
        yield long
        yield replace(long, glitches=(11,))
        yield replace(long, glitches=(5, 13, 14, 22))
        yield replace(long, glitches=(2, 5, 8, 10, 13, 15, 17, 20, 23, 26, 28))
        yield replace(long, repeats=(9, 17))
        yield replace(long, repeats=tuple(range(4, 30, 4)))
        yield replace(long, late_or_not_ms=PERIOD_MS / 2)
        yield replace(long, jitter_ms=6.0)
        yield replace(long, drops=(14,))
        yield replace(long, slower=1 / 12)


def real_unsteady_takes() -> Iterator[Take]:
    """Yield the ball with dropped frames: in the middle, at the border, two of them, and a repeated one."""
    for drops in ((20,), (12,), (26,), (10, 22), (3,), (31,), (15, 16)):
        yield Take(BALL, 0, frames=35 - len(drops), drops=drops)
    yield Take(BALL, 0, frames=35, doubles=(18,))
    yield Take(BALL, 0, frames=35, doubles=(25,))


def real_takes(every: int) -> Iterator[Take]:
    """Yield the ball in all images, cut at starts `every` frames apart, and with one camera a frame late."""
    yield Take(BALL, 0, frames=35)
    yield Take(BALL, 0, frames=34, late_ms=1e3 / 60)
    yield Take(BALL, 0, frames=35, guess=True)
    yield Take(BALL, 0, frames=34, late_ms=1e3 / 60, guess=True)
    yield Take(BALL, 0, frames=34, drops=(20,), guess=True)
    yield Take(BALL, 0, frames=24, start=4, guess=True)
    for fault in FAULTS[:-1]:
        for size in SIZES_PX[1::2]:
            yield Take(BALL, 0, frames=35, geometry_px=size, fault=fault)
    for frames in (28, 24, 16):
        for start in range(0, 36 - frames, every):
            yield Take(BALL, 0, frames=frames, start=start)


def session_of(take: Take, cache: Path, footage: Path | None) -> Path:
    """Return its session, written on the first call."""
    folder = cache / take.name
    if not (folder / "session.json").is_file():
        if take.kind == BALL:
            assert footage is not None
            _import_ball(take, cache, footage / "ball_launch")
        else:
            _paint(take, cache)
        if take.guess:
            (folder / CALIBRATION).unlink()
    return folder


def _paint(take: Take, cache: Path) -> Session:
    stage, views = (STAGES | FLAT_STAGES)[take.kind](take.seed)
    rng = np.random.default_rng([take.seed, 7])
    begin_s = float(rng.uniform(0.05, 0.1))
    writer, delays_ms = SessionWriter.create(cache, take.name), take.delays_ms()
    images: dict[str, Array] = {}
    for k in range(take.frames):
        for name, view in views.items():
            off_ms = 0.0 if name == "left" else delays_ms[k] + take.jitter_ms * rng.uniform(-2, 2)
            rolling = take.fault == ROLLING and name == "right"
            strips = STRIPS if rolling else 1
            parts = []
            for part in range(strips):
                row_ms = ((part + 0.5) / strips - 0.5) * READOUT_MS_PER_PX * take.geometry_px
                seen = stage.look(view, begin_s + (k * PERIOD_MS + off_ms + row_ms * rolling) / 1e3, rng)
                parts.append(seen[part * HEIGHT // strips : (part + 1) * HEIGHT // strips])
            if name == "left" or k not in take.repeats:
                images[name] = np.concatenate(parts)
            add_image(writer, name, k, images[name])
    near, far = (3.0, 30.0) if stage.rig_path else (2.5, 6.0)
    wrong = views | {"right": _wrong((views["left"], views["right"]), (near, far), take, rng)}
    return finish(writer, wrong, take.frames)


def finish(writer: SessionWriter, views: Mapping[str, View], frames: int) -> Session:
    """Finish a painted session of this number of instants with its calibration."""
    calibration = {name: view.to_calibration() for name, view in views.items()}
    writer.set_calibration(Calibration(cameras=calibration, source="painted"))
    facts = make_facts(width=WIDTH, height=HEIGHT, period_ns=round(PERIOD_MS * 1e6))
    instants = tuple(round(k * PERIOD_MS * 1e6) for k in range(frames))
    burst = BurstRecord(instants_ns=instants, period_ns=round(PERIOD_MS * 1e6))
    return writer.finish([CameraRecord(name=name, facts=facts) for name in views], burst, origin="imported")


def add_image(writer: SessionWriter, name: str, k: int, image: Array) -> None:
    """Add a grey image to a painted session, as a PNG."""
    data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
    at_ns = round(k * PERIOD_MS * 1e6)
    writer.add_image(data, camera=name, instant=k, leader_ns=at_ns, suffix=".png")


def _wrong(
    views: tuple[View, View], depths: tuple[float, float], take: Take, rng: np.random.Generator
) -> View:
    """Return the second view with the take's fault, so that points have its median epipolar error."""
    left, right = views
    if not take.geometry_px or take.fault == ROLLING:
        return right
    depth = rng.uniform(*depths, 500)
    at = np.column_stack([rng.uniform(0, left.width, 500), rng.uniform(0, left.height, 500)])
    points = left.unproject(at, depth) @ left.rotation
    points -= left.rotation.T @ left.translation
    there = right.project(points @ right.rotation.T + right.translation)
    turn, focal, bent = rng.normal(0, [1e-3, 4e-4, 1e-3]), rng.normal(0, 1.5e-3), rng.normal(0, 4e-3)
    middle, moved = rng.normal(0, 0.3), rng.normal(0, 1, 3) * (take.fault == "moved camera")
    mixed = not take.fault
    turn *= mixed or take.fault == "rotation"
    focal *= mixed or take.fault == "focal length"
    middle *= mixed or take.fault == "principal point"
    bent *= mixed or take.fault == "lens"
    apart = float(np.linalg.norm(right.centre - left.centre))

    def view(size: float) -> View:
        rotation = cv2.Rodrigues(size * turn)[0] @ right.rotation
        matrix = right.matrix.copy()
        matrix[0, 0] *= 1 + size * focal
        matrix[1, 1] *= 1 + size * focal
        matrix[1, 2] += size * middle
        distortion = right.distortion + np.array([size * bent, 0, 0, 0, 0])
        translation = -rotation @ (right.centre + 1e-3 * size * apart * moved)
        return replace(
            right, matrix=matrix, distortion=distortion, rotation=rotation, translation=translation
        )

    whole = 1.0
    found = view(whole)
    for _ in range(6):
        size = float(np.median(np.abs(epipolar_errors_px(left, found, at, there))))
        whole *= take.geometry_px / max(size, 1e-3)
        found = view(whole)
    return found


def _import_ball(take: Take, cache: Path, folder: Path) -> Session:
    """Import a part of a real recording; frame delays are made by renaming the right camera's images."""
    frames_late = np.rint(take.delays_ms() / take.period_ms).astype(int)
    source = cache / f"{take.name}-source"
    numbers = sorted(int(path.stem) for path in (folder / "L").iterdir() if int(path.stem))
    for name, later in (("L", 0 * frames_late), ("R", frames_late)):
        (source / name).mkdir(parents=True, exist_ok=True)
        for k, number in enumerate(numbers[take.start : take.start + take.frames]):
            other = folder / name / f"{number + later[k]}.png"
            if not other.is_file():
                raise BadInputError(f"{folder} has no picture {number + later} of {name}")
            link = source / name / f"{k}.png"
            if not link.exists():
                link.symlink_to(other)
    options = ImportOptions(fps=60, calibration=(str(folder / "calibration"),), unit="in")
    (session,) = import_found([str(source)], cache, take.name, options)
    if take.geometry_px:
        own = session.calibration()
        assert own is not None
        left, right = (View.from_calibration(own.cameras[n], *BALL_SIZE) for n in ("L", "R"))
        found = _wrong((left, right), BALL_DEPTHS, take, np.random.default_rng(take.seed))
        spoilt = msgspec.structs.replace(own, cameras={**own.cameras, "R": found.to_calibration()})
        (session.folder / CALIBRATION).write_bytes(msgspec.json.encode(spoilt))
    return session
