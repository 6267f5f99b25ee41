"""`reconstruct panorama`: panorama of one instant of a session, or of a folder of images."""

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from capture_app.common.errors import BadInputError
from capture_app.session.format.manifest import MANIFEST
from reconstruction.calibration.calibrated_rig import calibrated_views
from reconstruction.calibration.stored import choose_calibration
from reconstruction.common.geometry import Array, View
from reconstruction.common.image_files import read_small_image, save_picture
from reconstruction.common.native_libraries import opencv_calls
from reconstruction.common.outputs import comparison_folder, write_metrics
from reconstruction.panorama.overlap import Misalignment, OverlapScore, score_overlaps
from reconstruction.panorama.registration import MAX_SIDE_PX, PanoramaStitcher
from reconstruction.session.conditions import nearest_frame_offset
from reconstruction.session.dataset import Dataset
from reconstruction.session.moving_pixels import SceneMotion
from reconstruction.session.provenance import Provenance, with_provenance

SUFFIXES = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp"}

CACHED_BYTES_PER_PIXEL = 12
"""Memory per pixel of a session's image: both conditions with their motion masks, and the cache."""


@dataclass(frozen=True, kw_only=True)
class PanoramaOptions:
    """Options of a panorama; `offset_ms` also composes it with every second camera delayed by this much."""

    instant: int = 0
    offset_ms: float | None = None
    time_shifts_ms: Mapping[str, float] = field(default_factory=dict)
    """Corrections added to the times of the named cameras."""


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

The conditions are `synced`, and `offset` if requested. The fields are `left_out` (cameras without an image of
the instant, with the reason), and for a session `calibration` and `actual_offset_ms`.
"""


def panorama(sources: tuple[Path, ...], out: Path, options: PanoramaOptions) -> PanoramaResult:
    """Make a panorama of a session, of a folder of images or of single images; write it to `out`.

    Raises:
        SimulshotError: the images cannot be read or stitched.
    """
    began = time.monotonic()
    with comparison_folder(out) as output:
        conditions, views, late, facts = _load_input(sources, options)
        with opencv_calls("stitching"):
            try:
                stitcher = PanoramaStitcher(*conditions["synced"], views)
            except ValueError as error:
                raise BadInputError(
                    f"the pictures cannot be stitched: {error}",
                    hint="take them from one place, with a third of overlap between neighbours",
                ) from error
            made = {
                name: _save_panorama(stitcher, late, pictures, name, output.folder)
                for name, pictures in conditions.items()
            }
        facts["left_out"] |= stitcher.left_out
        result = PanoramaResult(
            source=" ".join(map(str, sources)),
            used=stitcher.used,
            synced=made["synced"],
            offset=made.get("offset"),
            **facts,
        )
        result = with_provenance(result, began, options.time_shifts_ms)
        write_metrics(output.folder, result)
    return result


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


def _load_input(sources: Sequence[Path], options: PanoramaOptions) -> Input:
    """Read the images; a session must be the only source.

    Raises:
        BadInputError: there are none, or they cannot be read, or not at this instant and offset.
    """
    if len(sources) == 1 and (sources[0] / MANIFEST).exists():
        return _session_input(sources[0], options)
    asked = {"--offset-ms": options.offset_ms is not None, "--time-shift-ms": bool(options.time_shifts_ms)}
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
    return {"synced": (images, {})}, {}, [], {"left_out": {}}


def _session_input(folder: Path, options: PanoramaOptions) -> Input:
    instant = options.instant
    dataset = Dataset.open(folder, options.time_shifts_ms)
    dataset.fit_memory(images=len(dataset.cameras), bytes_per_pixel=CACHED_BYTES_PER_PIXEL)
    cameras = [name for name in dataset.nearest_instants(instant, ()) if dataset.has_image(name, instant)]
    choose_calibration(dataset)
    calibration = dataset.calibration()
    known = calibrated_views(dataset, calibration) if calibration is not None else {}
    views = {name: known[name] for name in cameras if name in known}
    motion = SceneMotion(dataset, 1) if len(dataset.instants_ns) > 1 else None
    shown = {"synced": dict.fromkeys(cameras, instant)}
    late, offset_ms = [], 0.0
    if options.offset_ms is not None:
        offset = nearest_frame_offset(dataset.instants_ns, dataset.period_ns, options.offset_ms)
        later, late = dict(offset.pairs).get(instant), cameras[1::2]
        if later is None or not dataset.has_images((name, later) for name in late):
            raise BadInputError(
                f"{folder} has no pictures {offset.actual_ms:.0f} ms after instant {instant}",
                hint="choose an earlier --instant",
            )
        shown["offset"], offset_ms = shown["synced"] | dict.fromkeys(late, later), offset.actual_ms
    conditions = {name: _pictures(dataset, motion, of) for name, of in shown.items()}
    facts = {
        "left_out": {c: f"it has no image of instant {instant}" for c in dataset.cameras if c not in cameras},
        "calibration": calibration.source_words if calibration is not None and views else "",
        "actual_offset_ms": offset_ms,
    }
    return conditions, views, late, facts


def _pictures(dataset: Dataset, motion: SceneMotion | None, shown: Mapping[str, int]) -> Pictures:
    moving = {name: motion.widened_moving(name, k) for name, k in shown.items()} if motion else {}
    return {name: dataset.image(name, k) for name, k in shown.items()}, moving
