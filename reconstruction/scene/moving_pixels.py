"""Detection of motion: moving pixels in the images of a static camera, mask files, and moving cameras."""

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from capture_app.common.errors import BadInputError, NotApplicableError
from capture_app.console.terminal import Progress
from capture_app.session.files.output_folder import OutputFolder, replaces_nothing
from reconstruction.common.geometry import Array
from reconstruction.common.image_files import write_image
from reconstruction.common.image_matching import track_there_and_back
from reconstruction.common.memory import ByteCache, memory_budget
from reconstruction.scene.conditions import evenly_spaced
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.pairs import GRID

MIN_AREA_PX = 24
"""Minimum area of a moving region; smaller ones are noise."""
MIN_GREY_STEP = 8.0
"""Minimum change of grey level (of 255) that counts as motion."""
SHAKE_PX = 0.7
"""Maximum shift of a static edge that is not motion, as with a vibrating camera."""
MARGIN_PX = 5
"""Margin around what moves, within which nothing counts as at rest."""
MIN_CELLS = 8
"""Minimum number of cells in which points can be tracked; with fewer the motion is unknown."""
MIN_STILL = 0.25
"""Minimum static fraction of the image; below it the camera moves, or moving objects fill its view."""


def median_background(images: Sequence[Array]) -> Array:
    """Return the static background of a burst: the median over time of its grey images, uint8."""
    background = np.empty_like(images[0])
    # The median copies its input; a few rows at a time keep the copies small.
    for rows in np.array_split(np.arange(len(background)), 1 + len(background) // 256):
        background[rows] = np.median(np.stack([image[rows] for image in images]), axis=0)
    return background


def detect_moving(image: Array, neighbours: Sequence[Array], still: Array) -> Array:
    """Return the moving pixels (bool) of one grey image.

    A moving pixel differs from the burst's `still` background and from each of the neighbours in time (other
    images of the same camera). The difference to one neighbour alone also shows where the object will be. The
    difference to the background alone also shows where it was for most of the burst.
    """
    differences = [_grey_difference(image, in_light_of(image, other)) for other in (*neighbours, still)]
    change = np.minimum.reduce(differences)
    # Robust standard deviation of the differences of static pixels.
    noise = max(float(np.median(difference)) for difference in differences) * 1.4826
    mask = (change > max(MIN_GREY_STEP, 4.0 * noise) + SHAKE_PX * _gradient(still)).astype(np.uint8)
    for how, size_px in ((cv2.MORPH_OPEN, 3), (cv2.MORPH_CLOSE, 9)):
        mask = cv2.morphologyEx(mask, how, _disc(size_px))
    return _fill_spots(mask)


def dilate(mask: Array, radius_px: int) -> Array:
    """Return a mask (bool) dilated by a radius, px."""
    return np.asarray(cv2.dilate(mask.astype(np.uint8), _disc(2 * radius_px + 1)) > 0)


def _disc(size_px: int) -> Array:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size_px, size_px)))


def in_light_of(image: Array, other: Array) -> Array:
    """Return another image of the same camera as it would be in this image's light, grey.

    A lamp that flickers scales the image, mains light with a rolling shutter its rows, of which most stands
    still. The image is returned unchanged unless this explains half of the difference.
    """
    some, others = (picture[::4, ::4].astype(np.float32) for picture in (image, other))
    gains = np.median((some + 1) / (others + 1), axis=1)
    # Light may differ between 40 strips of an image.
    rows = max(1, len(gains) // 40)
    gains = np.median(sliding_window_view(np.pad(gains, rows, mode="edge"), 2 * rows + 1), axis=1)[:, None]
    changed, left = (float(np.median(np.abs(some - picture))) for picture in (others, others * gains))
    if left >= changed / 2:
        return other
    # From this grey level on, a pixel may be saturated.
    white = 254
    lit = np.minimum(other * cv2.resize(gains, (1, len(other))), white)
    # Of what was white already, no light shows how bright it is.
    return np.asarray(np.where(other >= white, np.maximum(lit, image), lit))


def _grey_difference(a: Array, b: Array) -> Array:
    """Return the smoothed absolute difference in grey levels, without changes of overall brightness."""
    delta = a.astype(np.float32) - b.astype(np.float32)
    return np.asarray(np.abs(cv2.GaussianBlur(delta - np.median(delta), (0, 0), 1.2)))


def _gradient(image: Array) -> Array:
    """Return the gradient of the smoothed image, grey levels per px."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.2)
    across, down = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    return np.asarray(cv2.magnitude(across, down) / 8)


def _fill_spots(mask: Array) -> Array:
    """Return regions of at least `MIN_AREA_PX`, with their holes filled."""
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    solid = np.zeros_like(mask)
    for outline in outlines:
        if cv2.contourArea(outline) >= MIN_AREA_PX:
            cv2.drawContours(solid, [outline], -1, 1, cv2.FILLED)
    return solid > 0


class SceneMotion:
    """Masks of moving pixels (bool, height x width) by camera and instant."""

    def __init__(self, dataset: Dataset, step: int) -> None:
        """`step`: number of instants between an image and those it is compared with."""
        self.dataset = dataset
        self.step = step
        cache_bytes = int(0.05 * memory_budget().limit_bytes)
        self._packed_moving = ByteCache(self._detect_moving, cache_bytes)
        self._packed_truth = ByteCache(self._read_truth, cache_bytes)
        self.background = ByteCache(self._background, cache_bytes)
        """The static background of a camera, grey uint8."""

    def require_several_images(self, cameras: Iterable[str]) -> None:
        """Raise NotApplicableError if one of these cameras has fewer than two images to compare."""
        if few := [camera for camera in cameras if len(self.dataset.instants(camera)) < 2]:
            raise NotApplicableError(
                f"{', '.join(few)} has fewer than two images: what moves is seen by comparing them",
                hint="take a burst of several instants",
            )

    def detected_moving(self, camera: str, instant: int) -> Array:
        """Return the moving pixels detected from the images alone; all computations use only these."""
        return self._unpacked(camera, self._packed_moving(camera, instant))

    def widened_moving(self, camera: str, instant: int) -> Array:
        """Return the moving pixels and `MARGIN_PX` around them, to leave out of calibration and the like."""
        return dilate(self.detected_moving(camera, instant), MARGIN_PX)

    def moving(self, camera: str, instant: int) -> Array:
        """Return the true moving pixels if the session has ground truth, else detected ones; for scores."""
        return self._unpacked(camera, self._packed_truth(camera, instant))

    def changing(self, camera: str, instant: int) -> Array:
        """Return pixels that move or change, such as shadows; the static control excludes them."""
        return np.asarray(self.moving(camera, instant) | self.detected_moving(camera, instant))

    def _unpacked(self, camera: str, packed: Array) -> Array:
        width, height = self.dataset.size(camera)
        return np.unpackbits(packed, count=width * height).reshape(height, width).view(bool)

    def _read_truth(self, camera: str, instant: int) -> Array:
        truth = self.dataset.ground_truth(camera, instant)
        return np.packbits(truth[1]) if truth is not None else self._packed_moving(camera, instant)

    def _background(self, camera: str) -> Array:
        there = self.dataset.instants(camera)
        # A longer burst is thinned to 25 images, or up to twice as many.
        images = list(self._readable(camera, there[:: max(1, len(there) // 25)]))
        # Where none can be read, the first one's error says why.
        return median_background(images or [self.dataset.grey(camera, there[0])])

    def _readable(self, camera: str, instants: Iterable[int]) -> Iterator[Array]:
        """Yield grey images to compare others with; broken ones are left out."""
        for instant in instants:
            with suppress(BadInputError):
                yield self.dataset.grey(camera, instant)

    def _detect_moving(self, camera: str, instant: int) -> Array:
        """Return the moving pixels, packed eight to a byte."""
        there = self.dataset.instants(camera)
        near = [k for k in (instant - self.step, instant + self.step) if k in there]
        near = near or [k for k in there if k != instant][:1]
        image, others = self.dataset.grey(camera, instant), list(self._readable(camera, near))
        return np.packbits(detect_moving(image, others, self.background(camera)))


def measure_camera_motion(dataset: Dataset, camera: str) -> tuple[float, float, float] | None:
    """Track points between some of a camera's images; None if too few can be tracked.

    Returns the static fraction of the image, and its median motion (px) in a time (ms).
    """
    times = [dataset.instants_ns[k] for k in dataset.instants(camera)]
    if len(times) < 2:
        return None
    # Half the burst shows slow motion; if nothing can be tracked over it, neighbouring images may do.
    # Half a second apart, or half the burst if that is shorter.
    for apart_ns in (min(500_000_000, (times[-1] - times[0]) // 2), 1):
        if followed := _follow_pairs(dataset, camera, max(1, apart_ns)):
            still_fraction, px, ms = map(float, np.median(followed, axis=0))
            return still_fraction, px, ms
    return None


def _follow_pairs(dataset: Dataset, camera: str, apart_ns: int) -> list[tuple[float, float, float]]:
    """Return static fraction, median motion (px) and time (ms) of image pairs at least `apart_ns` apart."""
    there, times = dataset.instants(camera), dataset.instants_ns
    later = {k: next((j for j in there if times[j] - times[k] >= apart_ns), None) for k in there}
    pairs = [(k, j) for k, j in later.items() if j is not None]
    motions = (
        (_cell_motions(dataset.grey(camera, k), dataset.grey(camera, j)), (times[j] - times[k]) / 1e6)
        for k, j in evenly_spaced(pairs, 4)
    )
    return [
        (float((moved < SHAKE_PX).mean()), float(np.median(moved)), ms)
        for moved, ms in motions
        if len(moved) >= MIN_CELLS
    ]


def find_shifts(dataset: Dataset, camera: str) -> list[tuple[int, int, float]]:
    """Return when a camera at rest was moved to another place, as a bumped tripod is.

    Each shift is the last instant before it, the first instant after it, and its size in px. A camera that
    moves steadily has none that ends.
    """
    there = dataset.instants(camera)

    def moved_px(first: int, second: int) -> float:
        """Return the motion of the image between two instants; 0 if it stays, or shows too little."""
        moved = _cell_motions(*(dataset.grey(camera, there[at]) for at in (first, second)))
        return (
            float(np.median(moved))
            if len(moved) >= MIN_CELLS and (moved < SHAKE_PX).mean() < MIN_STILL
            else 0.0
        )

    shifts = []
    # Between seven images, spread over the burst.
    for begin, end in pairwise(evenly_spaced(range(len(there)), 7)):
        if px := moved_px(begin, end):
            last = bisect_left(range(begin, end), True, key=lambda at: moved_px(begin, at) > 0) - 1 + begin
            first = bisect_left(range(begin, end), True, key=lambda at: moved_px(at, end) == 0) + begin
            shifts.append((there[last], there[max(first, last + 1)], px))
    return shifts


def _cell_motions(before: Array, after: Array) -> Array:
    """Return the median motion (n,), px, of each `GRID` cell in which points can be tracked.

    Each cell counts once, so that a highly textured object does not dominate.
    """
    if (scale := min(1.0, 640 / max(before.shape))) < 1:
        before, after = (
            cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            for image in (before, after)
        )
    height, width = before.shape
    across, down = width // GRID[0], height // GRID[1]
    corners = []
    for row, column in np.ndindex(*reversed(GRID)):
        left, top = column * across, row * down
        part = np.ascontiguousarray(before[top : top + down, left : left + across])
        if (some := cv2.goodFeaturesToTrack(part, 6, 0.1, 5)) is not None:
            corners.append(some.reshape(-1, 2) + np.array([left, top], np.float32))
    if not corners:
        return np.zeros(0)
    start = np.concatenate(corners)
    there, drift = track_there_and_back(before, after, start, 15)
    sure = np.where(drift < SHAKE_PX / 2, np.linalg.norm(there - start, axis=1) / scale, np.nan)
    cells = np.split(sure, np.cumsum([len(some) for some in corners])[:-1])
    return np.array([np.nanmedian(cell) for cell in cells if np.isfinite(cell).sum() >= 2])


def write_masks(motion: SceneMotion, out: Path, progress: Progress | None = None) -> dict[str, float]:
    """Write OUT/<camera>/<instant>.png for every image: white on moving pixels and a margin around them.

    Returns each camera's mean fraction of moving pixels. `progress` advances by a step for each camera.

    Raises:
        NotApplicableError: a camera has fewer than two images to compare.
        BadInputError: there is something else at `out`.
    """
    dataset = motion.dataset
    motion.require_several_images(dataset.cameras)
    shares: dict[str, float] = {}
    progress = progress or Progress(len(dataset.cameras))
    with OutputFolder(out, replaces_nothing) as output:
        for camera in dataset.cameras:
            progress.step(camera)
            masks = output.folder / camera
            masks.mkdir()
            moving = []
            for instant in dataset.instants(camera):
                mask = motion.widened_moving(camera, instant)
                moving.append(float(mask.mean()))
                # The dataset may be at a smaller scale than its session if memory is short.
                full = cv2.resize(
                    mask.astype(np.uint8) * 255,
                    dataset.size_on_disk(camera),
                    interpolation=cv2.INTER_NEAREST,
                )
                # Masks have their images' names, also where images were assigned to other instants.
                write_image(masks / f"{dataset.record(camera, instant).instant:06d}.png", full)
            shares[camera] = sum(moving) / len(moving)
    return shares
