"""Panorama of one instant of a session, or of images, with its residuals."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from capture_app.common.errors import BadInputError
from reconstruction.common.geometry import Array, View
from reconstruction.common.image_files import read_small_image, save_picture
from reconstruction.common.native_libraries import opencv_calls
from reconstruction.methods.panorama.overlap import Misalignment, OverlapScore, score_overlaps
from reconstruction.methods.panorama.panorama_method import Panorama
from reconstruction.methods.panorama.registration import MAX_SIDE_PX, PanoramaStitcher
from reconstruction.scene.conditions import SYNCHRONIZED, Condition, nearest_frame_offset
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.moving_pixels import SceneMotion
from reconstruction.scene.provenance import Provenance
from reconstruction.scene.scene import Scene

SUFFIXES = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp"}

CACHED_BYTES_PER_PIXEL = 12
"""Memory per pixel of a session's image: both conditions with their motion masks, and the cache."""


class ConditionPanorama(msgspec.Struct, frozen=True, kw_only=True):
    """Panorama of one condition; paths are relative to the output folder."""

    panorama: str
    ghosts: str
    width: int
    height: int
    misfit: Misalignment
    """Residual before blending, over all overlaps, or only overlaps of a delayed camera with another."""
    mover_misfit: Misalignment | None
    """Residual on moving objects; None for single images, in which motion is unknown."""
    overlaps: tuple[OverlapScore, ...]


class PanoramaResult(Provenance, frozen=True, kw_only=True):
    """All results of `reconstruct panorama`."""

    source: str
    used: tuple[str, ...]
    left_out: dict[str, str]
    """Images that were left out, with the reasons."""
    calibration: str = ""
    """Source of the lens parameters; empty if they were estimated from the images."""
    synced: ConditionPanorama
    offset: ConditionPanorama | None = None
    actual_offset_ms: float = 0.0


Pictures = tuple[dict[str, Array], dict[str, Array]]
"""One condition's images (BGR) by name, and the motion masks (bool) where motion is known."""


Input = tuple[dict[str, Pictures], dict[str, View], list[str], dict[str, Any]]
"""Input of a panorama: images by condition, known views, delayed cameras, and fields of the result.

The conditions are `synced`, and `offset` if requested. The fields are `source`, `left_out` (cameras without
an image of the instant, with the reason), and for a session `calibration` and `actual_offset_ms`.
"""


def stitch(given: Input, folder: Path) -> PanoramaResult:
    """Stitch images into a folder: panorama and ghosts of each condition, with one registration.

    Raises:
        BadInputError: the images cannot be stitched.
    """
    conditions, views, late, facts = given
    with opencv_calls("stitching"):
        try:
            stitcher = PanoramaStitcher(*conditions["synced"], views)
        except ValueError as error:
            raise BadInputError(
                f"the pictures cannot be stitched: {error}",
                hint="take them from one place, with a third of overlap between neighbours",
            ) from error
        made = {
            name: _save_panorama(stitcher, late, pictures, name, folder)
            for name, pictures in conditions.items()
        }
    facts["left_out"] |= stitcher.left_out
    return PanoramaResult(used=stitcher.used, synced=made["synced"], offset=made.get("offset"), **facts)


def _save_panorama(
    stitcher: PanoramaStitcher, late: Collection[str], shown: Pictures, condition: str, folder: Path
) -> ConditionPanorama:
    images, moving = shown
    layers = stitcher.layers(images)
    moving_masks = {name: stitcher.layer_mask(name, moving[name]) for name in layers if name in moving}
    overlaps, misfit, mover_misfit, ghosts = score_overlaps(
        layers, moving_masks, stitcher.projection.canvas, late
    )
    picture = stitcher.compose(layers)
    return ConditionPanorama(
        panorama=save_picture(folder, f"panorama_{condition}.jpg", picture),
        ghosts=save_picture(folder, f"ghosts_{condition}.jpg", ghosts),
        width=picture.shape[1],
        height=picture.shape[0],
        misfit=misfit,
        mover_misfit=mover_misfit,
        overlaps=overlaps,
    )


def image_input(sources: Sequence[Path], condition: Condition, options: Panorama) -> Input:
    """Read image files and folders of images.

    Raises:
        BadInputError: there are none, they cannot be read, or an option needs a session.
    """
    asked = {
        "--offset-ms": options.offset_ms is not None,
        "--condition": condition != SYNCHRONIZED,
        "--time-shift-ms": bool(options.time_shifts_ms),
    }
    if given := [option for option, is_given in asked.items() if is_given]:
        raise BadInputError(
            f"{given[0]} needs a session: single pictures have no times",
            hint=f"give a session, or leave out {given[0]}",
        )
    paths = [
        path
        for source in sources
        for path in (sorted(source.iterdir()) if source.is_dir() else (source,))
        if path == source or path.suffix.lower() in SUFFIXES
    ]
    if not paths:
        raise BadInputError(
            f"{sources[0]} is not a session and contains no images",
            hint="capture-app sessions list shows your sessions",
        )
    images: dict[str, Array] = {}
    for path in paths:
        images[path.name if path.name not in images else str(path)] = read_small_image(path, MAX_SIDE_PX)
    return {"synced": (images, {})}, {}, [], {"source": " ".join(map(str, sources)), "left_out": {}}


def session_input(scene: Scene, condition: Condition, options: Panorama) -> Input:
    """Read an instant's images of a session, also in the other condition if one is requested.

    Raises:
        BadInputError: the session lacks this instant, or its images in the condition.
    """
    instant = options.instant
    scene = scene.fitted(images=len(scene.dataset.cameras), bytes_per_pixel=CACHED_BYTES_PER_PIXEL)
    dataset = scene.dataset
    cameras = [name for name in dataset.nearest_instants(instant, ()) if dataset.has_image(name, instant)]
    views = {name: view for name, view in scene.given_views.items() if name in cameras}
    motion = scene.motion if len(dataset.instants_ns) > 1 else None
    shown = {"synced": dict.fromkeys(cameras, instant)}
    delayed, offset_ms = _delayed_instants(dataset, cameras, condition, options)
    if delayed:
        shown["offset"] = shown["synced"] | delayed
    conditions = {name: _pictures(dataset, motion, of) for name, of in shown.items()}
    facts = {
        "source": str(dataset.session.folder),
        "left_out": {c: f"it has no image of instant {instant}" for c in dataset.cameras if c not in cameras},
        "calibration": scene.source if views else "",
        "actual_offset_ms": offset_ms,
    }
    return conditions, views, list(delayed), facts


def _delayed_instants(
    dataset: Dataset, cameras: Sequence[str], condition: Condition, options: Panorama
) -> tuple[dict[str, int], float]:
    """Return the delayed cameras with the instants that they show, and the largest delay, ms."""
    instant, times_ns = options.instant, dataset.instants_ns
    if options.offset_ms is None:
        chosen = dataset.nearest_instants(instant, condition.offsets_ms(dataset.cameras, instant))
        delayed = {name: chosen[name] for name in cameras if chosen[name] != instant}
        late_ms = [(times_ns[k] - times_ns[instant]) / 1e6 for k in delayed.values()]
        offset_ms, hint = max(late_ms, key=abs, default=0.0), "choose another --instant"
    elif condition != SYNCHRONIZED:
        raise BadInputError("--offset-ms is a condition of its own", hint="leave it out, or --condition")
    else:
        offset = nearest_frame_offset(times_ns, dataset.period_ns, options.offset_ms)
        offset_ms, hint = offset.actual_ms, "choose an earlier --instant"
        later = dict(offset.pairs).get(instant)
        delayed = {} if later is None else dict.fromkeys(cameras[1::2], later)
    if (options.offset_ms is not None and not delayed) or not dataset.has_images(delayed.items()):
        raise BadInputError(
            f"{dataset.session.folder} has no pictures {offset_ms:.0f} ms after instant {instant}", hint=hint
        )
    return delayed, offset_ms


def _pictures(dataset: Dataset, motion: SceneMotion | None, shown: Mapping[str, int]) -> Pictures:
    moving = {name: motion.widened_moving(name, k) for name, k in shown.items()} if motion else {}
    return {name: dataset.image(name, k) for name, k in shown.items()}, moving
