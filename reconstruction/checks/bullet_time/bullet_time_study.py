"""Bullet time: one instant from camera to camera, stabilized, as pictures and as an animation."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np

from capture_app.session.format.lens import nearest_point
from capture_app.session.reading.take_sheet import encode_animation, fit_canvas
from reconstruction.common import wording
from reconstruction.common.camera_paths import order_of_views
from reconstruction.common.drawing import EMPTY
from reconstruction.common.geometry import Array, View, look_along, resize_view
from reconstruction.common.image_files import save_picture
from reconstruction.method.comparison_results import CompareResult
from reconstruction.method.score import TIMING, Score
from reconstruction.method.study_result import StudyResult
from reconstruction.method.words import read_words
from reconstruction.scene.conditions import evenly_spaced
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.moving_pixels import SceneMotion
from reconstruction.scene.scene import Scene

MAX_CAMERAS = 20
PANEL_PX = 400
"""Longest side of each half; two thirds of it with more than `MANY_CAMERAS` pictures."""
STRIP_PX = 34
GAP_PX = 6
STEP_MS, REST_MS = 160, 480
PAPER, INK = (26, 22, 20), (226, 231, 233)
TONES = ((255, 179, 109), (87, 156, 255))
"""BGR colours of the first and second sequence, as in the report's dark theme."""
MAX_MISS_FRACTION = 0.12
"""Maximum distance of the subject from its place in a camera's image, as a fraction of image width."""
ZOOMS = np.geomspace(0.6, 1.7, 50)
"""Zooms tried in order until every picture is filled; beyond, too little of the images would remain."""
LATE_MS = (0.0, 66.0, -33.0, 33.0, -66.0)
"""Delays of the offset cameras in sweep order; neighbours are far apart in time."""
LONG_SIDE_PX = 512
SMALLER_PX, MANY_CAMERAS = 384, 8
"""Size for more than this number of cameras, so that a report stays at a few megabytes."""
QUALITY = 82
MIN_MOVING_PX = 40
"""Minimum number of moving pixels in an image that locate the subject."""


class BulletTime(msgspec.Struct, frozen=True, kw_only=True):
    """One instant from camera to camera, synchronized and with delayed cameras.

    `synced` and `offset` are the paths of the pictures, in the order of `cameras`.
    """

    cameras: tuple[str, ...]
    """Cameras in sweep order."""
    instant: int
    synced: tuple[str, ...]
    offset: tuple[str, ...]
    offsets_ms: tuple[float, ...]
    """Delay of each camera's offset picture."""
    stabilized: bool
    """Whether the pictures are rotated and zoomed so that the subject stays in place."""
    ordered_by_position: bool
    """Whether the order follows the cameras' positions instead of their names."""
    file: str
    """Path of an animation of both sequences side by side."""
    synced_step_px: float | None = None
    """Largest step of the largest moving object between pictures, px; None if not stabilized."""
    offset_step_px: float | None = None


def save_animation(
    folder: Path,
    name: str,
    halves: tuple[Sequence[Array], Sequence[Array]],
    titles: tuple[str, Sequence[str]],
) -> str:
    """Write folder/pictures/`name`.gif and return its path relative to the folder.

    `halves` are pictures (BGR uint8) of equal number and size. `titles` holds the title of the first half and
    one title for each picture of the second.
    """
    side = PANEL_PX if len(halves[0]) <= MANY_CAMERAS else PANEL_PX * 2 // 3
    there = [
        np.hstack(
            [
                left := _panel(first, titles[0], TONES[0], side),
                np.full((left.shape[0], GAP_PX, 3), PAPER, np.uint8),
                _panel(second, title, TONES[1], side),
            ]
        )
        for first, second, title in zip(*halves, titles[1], strict=True)
    ]
    target = folder / "pictures" / f"{name}.gif"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(encode_animation(there, ".gif", STEP_MS, REST_MS))
    return f"pictures/{name}.gif"


def _panel(picture: Array, title: str, tone: tuple[int, int, int], side: int) -> Array:
    scale = side / max(picture.shape[:2])
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    strip = np.full((STRIP_PX, small.shape[1], 3), PAPER, np.uint8)
    middle = STRIP_PX // 2
    cv2.circle(strip, (middle, middle), 6, tone, cv2.FILLED, cv2.LINE_AA)
    cv2.putText(strip, title, (middle + 15, middle + 6), INK, cv2.FontFace("sans"), 16, 500)
    return np.vstack([strip, small])


def triangulate_subject(views: Mapping[str, View], seen: Mapping[str, Array]) -> tuple[Array, float] | None:
    """Triangulate the subject (3,), in the rig's frame, from one pixel (2,) per camera.

    Minimizes the squared distances from the pixels' rays. Also returns the maximum reprojection error, px.
    None if fewer than two cameras saw something. None also if the point is behind a camera, outside its
    image, or farther than `MAX_MISS_FRACTION` from its pixel.
    """
    if len(seen) < 2:
        return None
    rays = np.array([views[name].rays(pixel)[0] @ views[name].rotation for name, pixel in seen.items()])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    if (point := nearest_point(np.array([views[name].centre for name in seen]), rays, 1e8)) is None:
        return None
    pixels = {name: project_point(view, point) for name, view in views.items()}
    inside = (0 <= x < views[name].width and 0 <= y < views[name].height for name, (x, y) in pixels.items())
    misses = {name: float(np.linalg.norm(pixels[name] - pixel)) for name, pixel in seen.items()}
    near = (miss <= MAX_MISS_FRACTION * views[name].width for name, miss in misses.items())
    return (point, max(misses.values())) if all(inside) and all(near) else None


def project_point(view: View, point: Array) -> Array:
    """Return a view's pixel (2,) of a point in the rig's frame; NaN if it is behind the view."""
    at = view.rotation @ point + view.translation
    return np.asarray(view.project(at.reshape(1, 3))[0]) if at[2] > 1e-9 else np.full(2, np.nan)


def stabilize_views(
    views: Mapping[str, View], point: Array, width: int, height: int
) -> dict[str, View] | None:
    """Return undistorted, upright views of one scale that show the point at one place, width x height px.

    Each view keeps its camera's position and is only rotated and zoomed, so it shows nothing that the camera
    did not see. The place is the mean of the point's positions in the cameras' images. None if no zoom fills
    all views.
    """
    down = np.mean([view.rotation[1] for view in views.values()], axis=0)
    places = [(project_point(view, point) + 0.5) / (view.width, view.height) for view in views.values()]
    x, y = np.mean(places, axis=0) * (width, height) - 0.5
    range_to = {name: float(np.linalg.norm(point - view.centre)) for name, view in views.items()}
    scale = (
        float(np.median([view.focal / view.width / range_to[name] for name, view in views.items()])) * width
    )
    turned = {}
    for name, view in views.items():
        rotation = look_along((point - view.centre) / range_to[name], down)
        matrix = np.array([[range_to[name], 0, x], [0, range_to[name], y], [0, 0, 1.0]])
        turned[name] = View(width, height, matrix, np.zeros(5), rotation, np.asarray(-rotation @ view.centre))
    tried = (
        {
            name: replace(view, matrix=view.matrix @ np.diag([zoom, zoom, 1.0]))
            for name, view in turned.items()
        }
        for zoom in scale * ZOOMS
    )
    return next((held for held in tried if all(_filled(held[name], views[name]) for name in views)), None)


def _filled(held: View, view: View) -> bool:
    """Return whether the camera's own image reaches every edge of the stabilized view."""
    rays = held.rays(held.border(12)) @ held.rotation @ view.rotation.T
    if float(rays[:, 2].min()) < 0.1:
        return False
    pixels = view.project(rays)
    return bool(((pixels >= 0) & (pixels <= (view.width - 1, view.height - 1))).all())


def render_view(held: View, view: View, image: Array, empty: tuple[int, int, int]) -> Array:
    """Render a camera's image in its stabilized view (BGR); uncovered pixels are `empty`."""
    shrink = max(1.0, view.focal / held.focal)
    if shrink > 1.5:
        size = round(view.width / shrink), round(view.height / shrink)
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
        view = resize_view(view, *size)
    maps = cv2.initUndistortRectifyMap(
        view.matrix,
        view.distortion,
        held.rotation @ view.rotation.T,
        held.matrix,
        (held.width, held.height),
        cv2.CV_32FC1,
    )
    return np.asarray(
        cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=empty)
    )


class BulletTimeStudy(Score):
    """One instant from camera to camera, beside delayed cameras."""

    text = read_words(__package__)
    needs = (TIMING,)

    @classmethod
    def files(cls, found: StudyResult[BulletTime]) -> dict[str, Sequence[str]]:
        """Return the animation and its single pictures; see `Score.files`."""
        return {
            "from camera to camera, to share": [found.facts.file],
            "from camera to camera, picture by picture": [*found.facts.synced, *found.facts.offset],
        }

    def measure(self) -> StudyResult[Any]:
        """Render the sweep; see `Score.measure`."""
        assert self.context.folder is not None
        sweep = render_camera_sweep(self.scene, self.context.folder, self.known)
        if sweep is None:
            return self.skipped("no instant has images of two cameras at two times", unasked=True)
        return StudyResult(name=self.text.name, cameras=sweep.cameras, instants=1, facts=sweep)


def render_camera_sweep(scene: Scene, out: Path, known: CompareResult) -> BulletTime | None:
    """Write the sweep's pictures and an animation into out/pictures; None if no sweep is possible.

    Cameras are ordered by position if they are calibrated, else by name. Pictures of calibrated cameras are
    rotated and zoomed so that the subject stays in place. In the other condition each camera is delayed by
    one of `LATE_MS`, as far as the burst reaches. The animation says synchronized only if the images of the
    sweep's cameras were found to show one instant.
    """
    dataset, motion = scene.dataset, scene.motion
    calibrated = dict(scene.known_views)
    order = order_of_views(calibrated) if len(calibrated) > 1 else tuple(sorted(dataset.cameras))
    order = order[:: -(-len(order) // MAX_CAMERAS)]
    if (chosen := _choose_instant(dataset, motion, order)) is None:
        return None
    instant, late = chosen
    order = tuple(late)
    canvas = _canvas_size(dataset, order)
    stabilized = _stabilized_views(motion, calibrated, order, instant, canvas)

    def picture(name: str, k: int) -> Array:
        image, held = dataset.image(name, k), stabilized.get(name)
        if held is None:
            return fit_canvas(image, *canvas, EMPTY)
        return render_view(held, calibrated[name], image, EMPTY)

    halves = [picture(name, instant) for name in order], [picture(name, k) for name, k in late.items()]
    synced, offset = (
        tuple(
            save_picture(out, f"sweep_{name}_{kind}.jpg", frame, quality=QUALITY)
            for name, frame in zip(order, frames, strict=True)
        )
        for kind, frames in zip(("synced", "offset"), halves, strict=True)
    )
    offsets_ms = tuple((dataset.instants_ns[k] - dataset.instants_ns[instant]) / 1e6 for k in late.values())
    when = "synchronized" if known.together(order) else "as recorded"
    late_texts = [wording.timeliness(ms).replace(wording.GAP, " ") for ms in offsets_ms]
    names = [f"{name}: {text}" for name, text in zip(order, late_texts, strict=True)]
    return BulletTime(
        cameras=order,
        instant=instant,
        synced=synced,
        offset=offset,
        offsets_ms=offsets_ms,
        stabilized=bool(stabilized),
        ordered_by_position=len(calibrated) > 1,
        file=save_animation(out, "sweep", halves, (when, names)),
        synced_step_px=_largest_step_px(motion, calibrated, stabilized, dict.fromkeys(order, instant)),
        offset_step_px=_largest_step_px(motion, calibrated, stabilized, late),
    )


def _choose_instant(
    dataset: Dataset, motion: SceneMotion, order: tuple[str, ...]
) -> tuple[int, dict[str, int]] | None:
    """Return the instant of the sweep, and the source instant of each camera's delayed image.

    Candidates are ranked by cameras with both images, then by distinct times, then by closeness to `LATE_MS`.
    Of the best, the instant with the most motion is chosen.
    """
    target_ns = {name: LATE_MS[place % len(LATE_MS)] * 1e6 for place, name in enumerate(order)}
    times = dataset.instants_ns
    there = {name: dataset.instants(name) for name in order}
    frames = {
        k: {
            name: min(there[name], key=lambda j: (abs(times[j] - time - target_ns[name]), j))
            for name in order
            if k in there[name]
        }
        for k, time in enumerate(times)
    }
    short_ns = {
        k: sum(abs(times[j] - times[k] - target_ns[n]) for n, j in late.items()) for k, late in frames.items()
    }
    ranks = {
        k: (len(late), len(set(late.values())), -round(short_ns[k] / max(1, dataset.period_ns)))
        for k, late in frames.items()
    }
    best = max(ranks.values())
    if min(best[:2]) < 2:
        return None
    likely = evenly_spaced([k for k, rank in ranks.items() if rank == best], 6)
    instant = max(likely, key=lambda k: sum(int(motion.detected_moving(n, k).sum()) for n in frames[k]))
    return instant, frames[instant]


def _stabilized_views(
    motion: SceneMotion,
    views: Mapping[str, View],
    order: tuple[str, ...],
    instant: int,
    canvas: tuple[int, int],
) -> dict[str, View]:
    """Return views that hold the subject in place; empty if the cameras disagree about its position.

    The subject is the largest moving object or the centre of all motion, whichever has the smaller error.
    """
    ours = {name: views[name] for name in order if name in views}
    if len(ours) < len(order):
        return {}
    detected = ((name, motion.detected_moving(name, instant)) for name in order)
    masks = {name: mask for name, mask in detected if int(mask.sum()) >= MIN_MOVING_PX}
    subjects = (
        triangulate_subject(ours, {name: middle(mask) for name, mask in masks.items()})
        for middle in (_largest_centroid, _centroid)
    )
    if not (placed := [place for place in subjects if place is not None]):
        return {}
    point, _ = min(placed, key=itemgetter(1))
    return stabilize_views(ours, point, *canvas) or {}


def _centroid(mask: Array) -> Array:
    """Return the centroid of a mask, px (2,)."""
    return np.asarray(np.argwhere(mask).mean(0)[::-1])


def _largest_centroid(mask: Array) -> Array:
    """Return the centroid of the largest component of a mask, px (2,)."""
    _, _, stats, middles = cv2.connectedComponentsWithStats(np.asarray(mask, np.uint8))
    return np.asarray(middles[1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))])


def _largest_step_px(
    motion: SceneMotion, views: Mapping[str, View], stabilized: Mapping[str, View], taken: Mapping[str, int]
) -> float | None:
    """Return the largest step of the largest moving object between stabilized pictures, px."""
    seen = [
        render_view(held, views[name], motion.moving(name, taken[name]).astype(np.uint8), (0, 0, 0))
        for name, held in stabilized.items()
    ]
    if not seen or not all(mask.any() for mask in seen):
        return None
    return float(np.linalg.norm(np.diff(list(map(_largest_centroid, seen)), axis=0), axis=1).max())


def _canvas_size(dataset: Dataset, order: Sequence[str]) -> tuple[int, int]:
    """Return width and height of the pictures, px, in the largest camera's aspect ratio."""
    size = max((dataset.size(name) for name in order), key=math.prod)
    scale = min(1.0, (SMALLER_PX if len(order) > MANY_CAMERAS else LONG_SIDE_PX) / max(size))
    return round(size[0] * scale), round(size[1] * scale)
