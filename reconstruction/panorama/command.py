"""`reconstruct stitch`: the panorama of a session's instant, or of a folder of pictures."""

import time
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from capture_app.errors import BadInputError
from capture_app.session.format.manifest import MANIFEST
from reconstruction.common.drawing import save_picture
from reconstruction.common.geometry import Array
from reconstruction.common.image_files import read_image
from reconstruction.common.native_libraries import library_versions
from reconstruction.common.output_folder import comparison_folder, write_metrics
from reconstruction.panorama.ghosting import OverlapScore
from reconstruction.panorama.opencv_stitcher import Panorama, PanoramaStitcher
from reconstruction.session.dataset import Dataset
from reconstruction.session.frame_offset import nearest_frame_offset
from reconstruction.session.scene_motion import SceneMotion

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
    versions: dict[str, str] = {}


def stitch(sources: tuple[Path, ...], out: Path, options: StitchOptions) -> PanoramaResult:
    """Make a panorama of a session, of a folder of pictures or of pictures; write it to `out`.

    Raises:
        SimulshotError: the pictures cannot be read, or make no panorama.
    """
    began = time.monotonic()
    with comparison_folder(out) as output:
        images, later, actual_ms, movers = _load(sources, options)
        stitching = PanoramaStitcher(images, movers)
        synced = _saved(stitching.compose(images), "synced", output.folder)
        offset = _saved(stitching.compose(later), "offset", output.folder) if later else None
        result = PanoramaResult(
            source=" ".join(map(str, sources)),
            used=stitching.used,
            left_out=stitching.left_out,
            synced=synced,
            offset=offset,
            actual_offset_ms=actual_ms,
            seconds=time.monotonic() - began,
            versions=library_versions(),
        )
        write_metrics(output.folder, result)
    return result


def _load(
    sources: tuple[Path, ...], options: StitchOptions
) -> tuple[dict[str, Array], dict[str, Array], float, dict[str, Array] | None]:
    """Pictures by name, the same of the offset condition (empty = none), its offset, and movers."""
    if len(sources) == 1 and (sources[0] / MANIFEST).exists():
        return _session(sources[0], options)
    if options.offset_ms is not None:
        raise BadInputError("pictures have no instants, so none can be offset", hint="give a session")
    paths: list[Path] = []
    for source in sources:
        if source.is_dir():
            paths += sorted(path for path in source.iterdir() if path.suffix.lower() in SUFFIXES)
        else:
            paths.append(source)
    if not paths:
        raise BadInputError(f"{sources[0]} is no session and holds no pictures")
    images: dict[str, Array] = {}
    for path in paths:
        images[path.name if path.name not in images else str(path)] = read_image(path)
    return images, {}, 0.0, None


def _session(
    folder: Path, options: StitchOptions
) -> tuple[dict[str, Array], dict[str, Array], float, dict[str, Array] | None]:
    dataset = Dataset.open(folder)
    count, instant = len(dataset.instants_ns), options.instant
    if not 0 <= instant < count:
        raise BadInputError(f"{folder} has no instant {instant}", hint=f"it has 0 to {count - 1}")
    cameras = [name for name in dataset.cameras if dataset.has_image(name, instant)]
    images = {name: dataset.image(name, instant) for name in cameras}
    if count < 2:
        return images, {}, 0.0, None
    motion = SceneMotion(dataset, 1)
    movers = {name: motion.widened_movers(name, instant) for name in cameras}
    if options.offset_ms is None:
        return images, {}, 0.0, movers
    offset = nearest_frame_offset(dataset.instants_ns, dataset.period_ns, options.offset_ms)
    partner = dict(offset.pairs).get(instant)
    late = cameras[1::2]
    if partner is None or not all(dataset.has_image(name, partner) for name in late):
        raise BadInputError(
            f"{folder} has no pictures {offset.actual_ms:.0f} ms after instant {instant}",
            hint="choose an earlier --instant",
        )
    later = {name: dataset.image(name, partner if name in late else instant) for name in cameras}
    return images, later, offset.actual_ms, movers


def _saved(made: Panorama, condition: str, folder: Path) -> ConditionPanorama:
    flows = [overlap.flow_p95_px for overlap in made.overlaps]
    return ConditionPanorama(
        panorama=save_picture(folder, f"panorama_{condition}.jpg", made.picture),
        ghosts=save_picture(folder, f"ghosts_{condition}.jpg", made.ghosts),
        width=made.picture.shape[1],
        height=made.picture.shape[0],
        ghosting_px=float(np.mean(flows)) if flows else None,
        overlaps=made.overlaps,
    )
