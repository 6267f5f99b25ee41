"""`reconstruct stitch`: the panorama of a session's instant, or of a folder of pictures."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np

from capture_app.errors import BadInputError
from capture_app.session.format.manifest import MANIFEST
from reconstruction.common.geometry import Array
from reconstruction.common.image_files import read_image, save_picture
from reconstruction.common.memory_budget import memory_budget
from reconstruction.common.native_libraries import library_versions
from reconstruction.common.output_folder import comparison_folder, write_metrics
from reconstruction.panorama.ghosting import OverlapScore
from reconstruction.panorama.opencv_stitcher import Panorama, PanoramaStitcher
from reconstruction.session.dataset import Dataset
from reconstruction.session.frame_offset import nearest_frame_offset
from reconstruction.session.mover_detection import SceneMotion

SUFFIXES = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp"}


@dataclass(frozen=True, kw_only=True)
class StitchOptions:
    """`instant` of a session; `offset_ms`: also compose it with every second camera so much later."""

    instant: int = 0
    offset_ms: float | None = None


class ConditionPanorama(msgspec.Struct, frozen=True, kw_only=True):
    """One condition's panorama: paths relative to the output folder."""

    panorama: str
    ghosts: str
    width: int
    height: int
    ghosting_px: float | None
    """Mean of the overlaps' flow_p95_px."""
    overlaps: tuple[OverlapScore, ...]


class PanoramaResult(msgspec.Struct, frozen=True, kw_only=True):
    """Everything `reconstruct stitch` found."""

    source: str
    used: tuple[str, ...]
    left_out: dict[str, str]
    """Pictures that are not in it, and why."""
    synced: ConditionPanorama
    offset: ConditionPanorama | None = None
    actual_offset_ms: float = 0.0
    seconds: float = 0.0
    memory_notes: tuple[str, ...] = ()
    """What the memory budget changed."""
    versions: dict[str, str] = {}


@dataclass(frozen=True)
class StitchInput:
    """Pictures (BGR) by name; the same with every second camera late, by how much; and movers (bool)."""

    images: dict[str, Array]
    late_images: dict[str, Array] = field(default_factory=dict)
    """Empty where no offset is asked for."""
    offset_ms: float = 0.0
    movers: dict[str, Array] | None = None


def stitch(sources: tuple[Path, ...], out: Path, options: StitchOptions) -> PanoramaResult:
    """Make a panorama of a session, of a folder of pictures or of pictures; write it to `out`.

    Raises:
        SimulshotError: the pictures cannot be read, or make no panorama.
    """
    began = time.monotonic()
    with comparison_folder(out) as output:
        given = _load_input(sources, options.instant, options.offset_ms)
        stitcher = PanoramaStitcher(given.images, given.movers)
        synced = _save_panorama(stitcher.compose(given.images), "synced", output.folder)
        offset = None
        if given.late_images:
            offset = _save_panorama(stitcher.compose(given.late_images), "offset", output.folder)
        result = PanoramaResult(
            source=" ".join(map(str, sources)),
            used=stitcher.used,
            left_out=stitcher.left_out,
            synced=synced,
            offset=offset,
            actual_offset_ms=given.offset_ms,
            seconds=time.monotonic() - began,
            memory_notes=memory_budget().notes,
            versions=library_versions(),
        )
        write_metrics(output.folder, result)
    return result


def _save_panorama(made: Panorama, condition: str, folder: Path) -> ConditionPanorama:
    flows = [overlap.flow_p95_px for overlap in made.overlaps]
    return ConditionPanorama(
        panorama=save_picture(folder, f"panorama_{condition}.jpg", made.picture),
        ghosts=save_picture(folder, f"ghosts_{condition}.jpg", made.ghosts),
        width=made.picture.shape[1],
        height=made.picture.shape[0],
        ghosting_px=float(np.mean(flows)) if flows else None,
        overlaps=made.overlaps,
    )


def _load_input(sources: Sequence[Path], instant: int, offset_ms: float | None) -> StitchInput:
    """Read the pictures; a session is a single source.

    Raises:
        BadInputError: there are none, they cannot be read, or not at this instant and offset.
    """
    if len(sources) == 1 and (sources[0] / MANIFEST).exists():
        return _session_input(sources[0], instant, offset_ms)
    if offset_ms is not None:
        raise BadInputError("--offset-ms needs a session: single pictures have no instants")
    paths: list[Path] = []
    for source in sources:
        if source.is_dir():
            paths += sorted(path for path in source.iterdir() if path.suffix.lower() in SUFFIXES)
        else:
            paths.append(source)
    if not paths:
        raise BadInputError(f"{sources[0]} is not a session and holds no pictures")
    images: dict[str, Array] = {}
    for path in paths:
        images[path.name if path.name not in images else str(path)] = read_image(path)
    return StitchInput(images)


def _session_input(folder: Path, instant: int, offset_ms: float | None) -> StitchInput:
    dataset = Dataset.open(folder)
    cameras = [name for name in dataset.nearest_instants(instant, ()) if dataset.has_image(name, instant)]
    images = {name: dataset.image(name, instant) for name in cameras}
    if len(dataset.instants_ns) < 2:
        return StitchInput(images)
    motion = SceneMotion(dataset, 1)
    movers = {name: motion.widened_movers(name, instant) for name in cameras}
    if offset_ms is None:
        return StitchInput(images, movers=movers)
    offset = nearest_frame_offset(dataset.instants_ns, dataset.period_ns, offset_ms)
    late_instant = dict(offset.pairs).get(instant)
    late = cameras[1::2]
    if late_instant is None or not dataset.has_images((name, late_instant) for name in late):
        raise BadInputError(
            f"{folder} has no pictures {offset.actual_ms:.0f} ms after instant {instant}",
            hint="choose an earlier --instant",
        )
    late_images = images | {name: dataset.image(name, late_instant) for name in late}
    return StitchInput(images, late_images, offset.actual_ms, movers)
