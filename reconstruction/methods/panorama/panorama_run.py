"""Panorama of one instant of a session, or of images, with its residuals."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from capture_app.common.errors import BadInputError
from capture_app.common.text import pretty_json
from capture_app.session.files.durable import write_atomic
from capture_app.session.format.calibration import Calibration
from reconstruction.common.geometry import Array, View
from reconstruction.common.image_files import read_small_image, save_picture
from reconstruction.common.native_libraries import opencv_calls
from reconstruction.common.options import Pair
from reconstruction.methods.panorama.overlap import Misalignment, OverlapScore, score_overlaps
from reconstruction.methods.panorama.registration import MAX_SIDE_PX, PanoramaStitcher, register_images
from reconstruction.scene.conditions import Condition
from reconstruction.scene.instant_choice import instants_shown
from reconstruction.scene.provenance import Provenance
from reconstruction.scene.scene import Scene

SUFFIXES = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp"}

REGISTRATION = "registration.json"


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
    registration: str = REGISTRATION
    """File with each camera's lens and rotation, as a calibration has them, by which it was stitched."""


Pictures = tuple[dict[str, Array], dict[str, Array]]
"""One condition's images (BGR) by name, and the motion masks (bool) where motion is known."""


class Input(NamedTuple):
    """Input of a panorama."""

    conditions: dict[str, Pictures]
    """Images by condition: `synced`, and `offset` if requested."""
    views: Mapping[str, View]
    """Known views."""
    late: Sequence[str]
    """Delayed cameras."""
    facts: dict[str, Any]
    """Fields of the result: `source`, `left_out` (cameras without an image of the instant, with the reason).

    For a session also `calibration` and `actual_offset_ms`.
    """
    register: Pictures
    """The images by which the cameras are registered."""


class RegisteredInstant(NamedTuple):
    """The instant that each camera shows, and what stitches their images."""

    instant: int
    shown: dict[str, int]
    stitcher: PanoramaStitcher


def register_instants(
    scene: Scene, condition: Condition, instants: Sequence[int], cameras: Sequence[str], at: int | None
) -> Iterator[RegisteredInstant]:
    """Yield each instant's images under a condition, registered by an instant's synchronized images.

    They are registered `at` an instant, None = each at its own.

    Raises:
        ValueError: the images cannot be stitched.
        BadInputError: the burst does not contain the condition.
    """
    for instant in instants:
        shown = instants_shown(scene.dataset, condition, instant)
        stitcher = register_at(scene, tuple(cameras), instant if at is None else at)
        yield RegisteredInstant(instant, {name: shown[name] for name in stitcher.used}, stitcher)


def register_at(scene: Scene, cameras: tuple[str, ...], instant: int) -> PanoramaStitcher:
    """Register the cameras' images of an instant by what stands still, once for each scene.

    Raises:
        ValueError: the images cannot be stitched.
    """

    def register() -> PanoramaStitcher:
        images, moving = _pictures(scene, dict.fromkeys(cameras, instant), scene.motion.widened_moving)
        known = {name: view for name, view in scene.given_views.items() if name in cameras}
        return register_images(images, moving, known)

    return scene.once(("panorama", cameras, instant), register)


def stitch(given: Input, folder: Path) -> PanoramaResult:
    """Stitch images into a folder: panorama and ghosts of each condition, with one registration.

    Raises:
        BadInputError: the images cannot be stitched.
    """
    with opencv_calls("stitching"):
        try:
            stitcher = register_images(*given.register, given.views)
        except ValueError as error:
            raise BadInputError(
                f"the pictures cannot be stitched: {error}",
                hint="take them from one place, with a third of overlap between neighbours",
            ) from error
        made = {
            name: _save_panorama(stitcher, given.late, pictures, name, folder)
            for name, pictures in given.conditions.items()
        }
    cameras = {name: view.to_calibration() for name, view in stitcher.views.items()}
    write_atomic(folder / REGISTRATION, pretty_json(Calibration(cameras=cameras, unit="arbitrary")))
    facts = given.facts | {"left_out": given.facts["left_out"] | stitcher.left_out}
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


def image_input(sources: Sequence[Path]) -> Input:
    """Read image files and folders of images.

    Raises:
        BadInputError: there are none, or they cannot be read.
    """
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
    shown: Pictures = (images, {})
    facts = {"source": " ".join(map(str, sources)), "left_out": {}}
    return Input({"synced": shown}, {}, (), facts, shown)


def session_input(
    scene: Scene, condition: Condition, instant: int, pair: Pair | None, register_at: int | None
) -> Input:
    """Read an instant's images of a session, also in the other condition if one is requested.

    Raises:
        BadInputError: the session lacks this instant, or its images in the condition.
    """
    pair = scene.named_pair(pair)
    # Both conditions with their motion masks, and what is cached.
    scene = scene.fitted(images=len(scene.dataset.cameras), bytes_per_pixel=12)
    dataset = scene.dataset
    asked = pair or dataset.cameras
    dataset.chosen_instants([instant, instant if register_at is None else register_at])
    cameras = [name for name in asked if dataset.has_image(name, instant)]
    views = {name: view for name, view in scene.given_views.items() if name in cameras}
    shown = {"synced": dict.fromkeys(cameras, instant)}
    chosen, times_ns = instants_shown(dataset, condition, instant), dataset.instants_ns
    delayed = {name: chosen[name] for name in cameras if chosen[name] != instant}
    late_ms = max(((times_ns[k] - times_ns[instant]) / 1e6 for k in delayed.values()), key=abs, default=0.0)
    if not dataset.has_images(delayed.items()):
        raise BadInputError(
            f"{dataset.session.folder} has no pictures {late_ms:.0f} ms after instant {instant}",
            hint="choose another --instant",
        )
    if delayed:
        shown["offset"] = shown["synced"] | delayed
    # Scores are of what moves alone; registration also leaves out a margin around it.
    conditions = {name: _pictures(scene, picture, scene.motion.moving) for name, picture in shown.items()}
    facts = {
        "source": str(dataset.session.folder),
        "left_out": {c: f"it has no image of instant {instant}" for c in asked if c not in cameras},
        "calibration": scene.source if views else "",
        "actual_offset_ms": late_ms,
    }
    at = instant if register_at is None else register_at
    there = dict.fromkeys((name for name in cameras if dataset.has_image(name, at)), at)
    register = _pictures(scene, there, scene.motion.widened_moving)
    return Input(conditions, views, list(delayed), facts, register)


def _pictures(scene: Scene, shown: Mapping[str, int], moving_in: Callable[[str, int], Array]) -> Pictures:
    several = len(scene.dataset.instants_ns) > 1
    moving = {name: moving_in(name, k) for name, k in shown.items()} if several else {}
    return {name: scene.dataset.image(name, k) for name, k in shown.items()}, moving
