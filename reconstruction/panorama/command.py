"""`reconstruct stitch`: the panorama of a session's instant, or of a folder of pictures."""

import time
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from reconstruction.common.image_files import save_picture
from reconstruction.common.native_libraries import library_versions
from reconstruction.common.output_folder import comparison_folder, write_metrics
from reconstruction.panorama.ghosting import OverlapScore
from reconstruction.panorama.opencv_stitcher import Panorama, PanoramaStitcher
from reconstruction.panorama.stitch_input import load_input


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
        given = load_input(sources, options.instant, options.offset_ms)
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
