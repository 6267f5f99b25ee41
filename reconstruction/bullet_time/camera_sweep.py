"""The bullet-time sweep: one instant from camera to camera, and the same with cameras at other times."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from reconstruction.bullet_time.gif_animation import save_animation
from reconstruction.bullet_time.stabilization import render_view, stabilize_views, triangulate_subject
from reconstruction.calibration.camera_order import order_by_place
from reconstruction.common.drawing import EMPTY, fit_canvas
from reconstruction.common.geometry import Array, View
from reconstruction.common.image_files import save_picture
from reconstruction.report import wording
from reconstruction.scores.compare_results import BulletTime
from reconstruction.session.dataset import Dataset
from reconstruction.session.frame_offset import evenly_spread
from reconstruction.session.mover_detection import SceneMotion

MAX_CAMERAS = 20
LATE_MS = (0.0, 66.0, -33.0, 33.0, -66.0)
"""How late the cameras of the other condition are, in the sweep's order; neighbours are far apart in time."""
LONG_SIDE_PX = 512
SMALLER_PX, MANY_CAMERAS = 384, 8
"""With more cameras than that their pictures are made smaller, so that a report stays a few megabytes."""
QUALITY = 82
MAX_CANDIDATES = 6
"""Instants among which the one with the most motion is taken."""
MIN_MOVING_PX = 40
"""With fewer moving pixels in a picture the subject's place is unknown."""


def render_camera_sweep(
    dataset: Dataset,
    motion: SceneMotion,
    views: Mapping[str, View],
    out: Path,
    *,
    together: Callable[[Sequence[str]], bool] = lambda cameras: False,
) -> BulletTime | None:
    """Write the sweep's pictures and an animation of it into out/pictures; None where there is no sweep.

    The cameras come in the order of their places where they are calibrated, else by name. Pictures of
    calibrated cameras are rotated and zoomed so that what moves stays where it is; no view is interpolated.
    In the other condition each camera is late by one of `LATE_MS`, as far as the burst goes.
    The animation says synchronized only where the pictures of the sweep's cameras are `together`: found to be
    of one instant.
    """
    calibrated = {name: views[name] for name in dataset.cameras if name in views}
    order = order_by_place(calibrated) if len(calibrated) > 1 else tuple(sorted(dataset.cameras))
    order = order[:: -(-len(order) // MAX_CAMERAS)]
    chosen = _choose_instant(dataset, motion, order)
    if chosen is None:
        return None
    instant, late = chosen
    order = tuple(late)
    pictures = _SweepPictures(
        dataset,
        calibrated,
        _stabilized_views(motion, calibrated, order, instant),
        _canvas_size(dataset, order),
    )
    halves = (
        [pictures.picture(name, instant) for name in order],
        [pictures.picture(name, k) for name, k in late.items()],
    )
    synced, offset = (
        tuple(
            save_picture(out, f"sweep_{name}_{kind}.jpg", frame, quality=QUALITY)
            for name, frame in zip(order, frames, strict=True)
        )
        for kind, frames in zip(("synced", "offset"), halves, strict=True)
    )
    offsets_ms = tuple((dataset.instants_ns[k] - dataset.instants_ns[instant]) / 1e6 for k in late.values())
    known = "synchronized" if together(order) else "as recorded"
    titles = known, [f"{name}: {_plain(ms)}" for name, ms in zip(order, offsets_ms, strict=True)]
    return BulletTime(
        cameras=order,
        instant=instant,
        synced=synced,
        offset=offset,
        offsets_ms=offsets_ms,
        stabilized=bool(pictures.stabilized),
        ordered_by_position=len(calibrated) > 1,
        file=save_animation(out, "sweep", halves, titles),
        synced_step_px=_largest_step_px(pictures, motion, dict.fromkeys(order, instant)),
        offset_step_px=_largest_step_px(pictures, motion, late),
    )


def _choose_instant(
    dataset: Dataset, motion: SceneMotion, order: tuple[str, ...]
) -> tuple[int, dict[str, int]] | None:
    """The instant to stop at, and from which instant each camera's picture comes when it is late.

    Of the instants at which most cameras have both pictures, most at distinct times, and these nearest to
    `LATE_MS`, the one with the most motion.
    """
    wanted_ns = {name: LATE_MS[place % len(LATE_MS)] * 1e6 for place, name in enumerate(order)}
    times = dataset.instants_ns
    there = {name: dataset.instants(name) for name in order}
    found: dict[int, dict[str, int]] = {}
    for k, time in enumerate(times):
        found[k] = {
            name: min(there[name], key=lambda j: (abs(times[j] - time - wanted_ns[name]), j))
            for name in order
            if k in there[name]
        }
    short_ns = {
        k: sum(abs(times[j] - times[k] - wanted_ns[n]) for n, j in late.items()) for k, late in found.items()
    }
    frame_ns = max(1, dataset.period_ns)
    ranks = {
        k: (len(late), len(set(late.values())), -round(short_ns[k] / frame_ns)) for k, late in found.items()
    }
    best = max(ranks.values())
    if min(best[:2]) < 2:
        return None
    likely = [k for k, rank in ranks.items() if rank == best]
    likely = evenly_spread(likely, MAX_CANDIDATES)
    instant = max(likely, key=lambda k: sum(int(motion.detected_movers(n, k).sum()) for n in found[k]))
    return instant, found[instant]


def _stabilized_views(
    motion: SceneMotion, views: Mapping[str, View], order: tuple[str, ...], instant: int
) -> dict[str, View]:
    """Views that hold the subject in place; none where the cameras do not agree on where it is.

    The subject is the largest moving thing, or the middle of all that moves: whichever fits better.
    """
    ours = {name: views[name] for name in order if name in views}
    if len(ours) < len(order):
        return {}
    masks = {name: motion.detected_movers(name, instant) for name in order}
    masks = {name: mask for name, mask in masks.items() if int(mask.sum()) >= MIN_MOVING_PX}
    best: tuple[Array, float] | None = None
    for middle in (_largest_centroid, _centroid):
        found = triangulate_subject(ours, {name: middle(mask) for name, mask in masks.items()})
        if found is not None and (best is None or found[1] < best[1]):
            best = found
    if best is None:
        return {}
    return stabilize_views(ours, best[0], *_canvas_size(motion.dataset, order)) or {}


def _centroid(mask: Array) -> Array:
    """The middle of a mask, px (2,)."""
    return np.asarray(np.argwhere(mask).mean(0)[::-1])


def _largest_centroid(mask: Array) -> Array:
    """The middle of the largest spot of a mask, px (2,)."""
    _, _, stats, middles = cv2.connectedComponentsWithStats(np.asarray(mask, np.uint8))
    return np.asarray(middles[1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))])


@dataclass(frozen=True)
class _SweepPictures:
    """The cameras' pictures as the sweep shows them: as the stabilized views see them, else fitted."""

    dataset: Dataset
    views: Mapping[str, View]
    stabilized: Mapping[str, View]
    canvas: tuple[int, int]

    def picture(self, camera: str, instant: int) -> Array:
        """A camera's picture (BGR)."""
        image = self.dataset.image(camera, instant)
        if camera in self.stabilized:
            return render_view(self.stabilized[camera], self.views[camera], image, EMPTY)
        return fit_canvas(image, *self.canvas)


def _largest_step_px(pictures: _SweepPictures, motion: SceneMotion, taken: Mapping[str, int]) -> float | None:
    """The largest step of the largest moving thing's middle from one stabilized picture to the next, px."""
    middles = []
    for camera, instant in taken.items():
        if camera not in pictures.stabilized:
            return None
        mask = motion.moving(camera, instant).astype(np.uint8)
        seen = render_view(pictures.stabilized[camera], pictures.views[camera], mask, (0, 0, 0))
        if not seen.any():
            return None
        middles.append(_largest_centroid(seen))
    return float(np.linalg.norm(np.diff(middles, axis=0), axis=1).max())


def _canvas_size(dataset: Dataset, order: Sequence[str]) -> tuple[int, int]:
    """Width and height that the pictures are shown at, px, of the largest camera's shape."""
    width, height = max((dataset.size(name) for name in order), key=lambda size: size[0] * size[1])
    side = SMALLER_PX if len(order) > MANY_CAMERAS else LONG_SIDE_PX
    scale = min(1.0, side / max(width, height))
    return round(width * scale), round(height * scale)


def _plain(late_ms: float) -> str:
    return wording.timeliness(late_ms).replace(wording.GAP, " ")
